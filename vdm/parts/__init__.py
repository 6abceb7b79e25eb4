"""A body cut into parts: closed surface in -> parts that share the nodes of their cuts, each a closed body."""
