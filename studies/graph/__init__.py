"""The work of a study as a graph of pure functions with content keys.

In: a study and its cases. Out: files under their keys: meshes, answers and limits in the cache, cases in the run
directory. A node whose file is there and sound is not in the graph.
"""
