"""Bodies in parts: cuts a closed surface into parts, each closed, that share the nodes of their cuts."""
