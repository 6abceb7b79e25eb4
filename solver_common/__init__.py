"""What `vdm` and `fem_reference` have in common, so that neither needs the other.

The form of arrays, of answers and refusals; the points at which a pressure on facets is given; the estimate of a
condition.
"""
