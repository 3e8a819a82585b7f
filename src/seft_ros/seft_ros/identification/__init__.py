"""Identification of a rig from two tests: excitation, spectra, fitted models."""
