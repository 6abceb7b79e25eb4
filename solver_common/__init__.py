"""Shared by `vdm` and `fem_reference`, so that neither imports the other.

Array types, solutions and errors, the quadrature of facet pressures, and the condition estimate.
"""
