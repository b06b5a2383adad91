"""What grows: skeletons, simple or by the Weber-Penn model."""
