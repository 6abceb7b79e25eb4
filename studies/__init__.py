"""The workbench: study files in, comparison reports out."""


def __getattr__(name: str) -> str:
    """`__version__`, read when it is asked for: what reads it would slow the start of every command."""
    if name == "__version__":
        from importlib.metadata import version

        return version("vdmbench")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
