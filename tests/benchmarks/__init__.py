"""Measurements of time: run by `make bench`, never asserted by a test."""
