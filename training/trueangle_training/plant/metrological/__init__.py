"""Plant C: a metrologist's laboratory, from the lines of the grating to the digits of the autocollimator.

The grating is a table of single lines, friction a set of elastic stops, the joint heavy and its soak too short;
the reference has a certificate, the operator habits, and the noise a ring, switching levels and turbulent air.
"""
