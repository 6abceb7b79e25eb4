"""Surface models to compare VDM with: boundary elements and springs. No form of VDM imports them."""
