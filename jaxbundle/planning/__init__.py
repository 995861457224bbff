"""Blocks that are not measured yet."""
