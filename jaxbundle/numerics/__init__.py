"""Numerical foundations: double precision, compilation, padded shapes, files."""
