"""Finding problems and their causes, in a block before its adjustment and in an adjustment."""
