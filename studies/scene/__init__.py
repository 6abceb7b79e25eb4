"""The scene: supports and loads. In: a case and a mesh.

Out: `Scene`, the regions, supports and loads as arrays, for every model; `ModelResult`, the form of an answer.
"""
