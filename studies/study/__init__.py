"""The study. In: a study file. Out: `Study` and its cases, in SI units, or every mistake with its line; and the
registry of models, by the names that a study uses.
"""
