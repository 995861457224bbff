"""What knows no photograph: rotations."""
