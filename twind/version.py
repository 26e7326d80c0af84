"""Version and name of the distribution, in one place."""

__version__ = "0.1.0"
DISTRIBUTION = "twind-robot"  # `twind` on PyPI is another project
