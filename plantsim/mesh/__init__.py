"""Tetrahedral meshes and their files."""
