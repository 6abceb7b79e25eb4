"""The nearly incompressible volumetric reference on scikit-fem."""
