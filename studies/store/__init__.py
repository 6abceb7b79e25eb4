"""Results on disk: the only room that knows HDF5. In: a case, a run. Out: case files, the table of a study."""
