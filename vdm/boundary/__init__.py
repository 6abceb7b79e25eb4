"""The elastic body seen from its surface: symmetric Galerkin boundary elements of Kelvin's solution."""
