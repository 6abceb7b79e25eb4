"""From shapes and files to meshes: gmsh behind one module, readers, repair, refinement."""
