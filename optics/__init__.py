"""Laws of physics: pure functions, arrays in, arrays out; no files, no state, no randomness."""
