"""The effects, one file each: `EFFECT` of a file is its entry."""
