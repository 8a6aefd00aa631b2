"""Continuum prediction of powder blending in rotating blenders."""

__version__: str


def __getattr__(name: str) -> str:
    """The version, when it is asked for: `python -m scaleup` must import nothing before `__main__`.

    What it imports before that, it may find in the working folder.
    """
    if name != "__version__":
        raise AttributeError(f"module 'scaleup' has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("scaleup")
    except PackageNotFoundError:  # a source tree that was never installed
        return "0.0.0"
