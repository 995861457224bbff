"""The image equation and the camera models of the package."""
