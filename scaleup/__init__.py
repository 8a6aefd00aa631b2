"""Continuum prediction of powder blending in rotating blenders."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("scaleup")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0.0.0"
