"""Compensation methods of the literature, as a package on the entry point ``seft.compensation``."""
