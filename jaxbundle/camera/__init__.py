"""The image equation and the camera models."""
