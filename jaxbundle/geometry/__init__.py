"""Geometry without photographs: rotations, similarities, vectors."""
