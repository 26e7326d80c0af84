"""Version and name of the distribution, in one place."""

__version__ = "0.2.0"
DISTRIBUTION = "twind-robot"  # `twind` on PyPI is another project
