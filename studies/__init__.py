"""The workbench: study files in, comparison reports out."""

TYPE_CHECKING = False  # as in typing, whose import would slow the start of every command
if TYPE_CHECKING:
    from .api import Results, read, run

    __version__: str

__all__ = ["Results", "__version__", "read", "run"]


def __getattr__(name: str) -> object:
    """Load the names of `api`, and `__version__`, at their first use."""
    if name == "__version__":
        from importlib.metadata import version

        return version("vdmbench")
    if name in __all__:
        from . import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
