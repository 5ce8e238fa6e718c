"""Shipped examples: the joint and the campaign that the documentation uses."""
