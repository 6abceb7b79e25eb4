"""What is asked. In: a study file. Out: `Study` and its cases, in SI units, or every mistake with its line; which
models there are, by the names that a study writes.
"""
