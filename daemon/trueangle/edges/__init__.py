"""The only place for sockets, files, clocks and libraries; each library is touched in one module."""
