"""What a gripper does: rigid patches, and sequences of touches."""
