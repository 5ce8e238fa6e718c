"""Which trueangle this is."""

from importlib.metadata import PackageNotFoundError, version


def own_version() -> str:
    """The version of the installed package."""
    try:
        return version("trueangle")
    except PackageNotFoundError:
        return "unknown"
