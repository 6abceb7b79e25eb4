"""The body. In: a geometry as a study gives it. Out: `Mesh`, made by gmsh or read from a file, repaired, remeshed,
refined, and measures of its surface.
"""
