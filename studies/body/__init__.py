"""What it is asked of. In: a geometry as a study gives it. Out: `Mesh`, made by gmsh or read from a file, repaired,
remeshed, refined, and what is measured of a surface.
"""
