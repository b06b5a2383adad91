"""What bends: materials, stiffness, supports, loads, equilibrium."""
