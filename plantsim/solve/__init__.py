"""Linear algebra only: factor once, apply often."""
