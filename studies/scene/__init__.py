"""Where the body is held and pressed. In: a case and a mesh.

Out: `Scene`: regions, supports, loads as arrays, given to every model; `ModelResult`, the form of an answer.
"""
