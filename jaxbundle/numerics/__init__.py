"""What all computing rests on: double precision, compilation, padded shapes."""
