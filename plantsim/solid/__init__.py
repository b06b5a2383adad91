"""What is meshed: swept limbs joined to one solid by gmsh."""
