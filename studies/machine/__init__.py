"""Files, processes and memory of this machine. In: paths and limits. Out: files that are whole and ours,
locks, sealed arrays, what a process may take. It knows nothing of studies.
"""
