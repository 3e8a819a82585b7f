"""The figures and claims of the paper (Nakata & Combs 2012), reproduced."""
