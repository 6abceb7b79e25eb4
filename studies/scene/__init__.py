"""Where the body is held and pressed. In: a case and a mesh. Out: `Scene`: regions, supports, loads as arrays."""
