"""Results on disk; only this room knows HDF5. In: a case, a run. Out: case files, the table of a study."""
