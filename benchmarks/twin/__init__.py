"""The twin certificate: whether a simulated sensor agrees with a real one, clause by clause."""
