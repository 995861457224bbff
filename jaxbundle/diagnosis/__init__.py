"""What is wrong and who causes it: of a block before its adjustment, and of an adjustment."""
