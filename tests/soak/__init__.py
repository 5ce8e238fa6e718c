"""Mixed load on a `trueangled` of its own process for as long as one likes; see `__main__`."""
