"""How often the diagnosis is right: cases of the development plant, diagnosed and scored.

`python -m tests.benchmarks.diagnosis_check --help`; `--short` is the form of the continuous integration.
"""
