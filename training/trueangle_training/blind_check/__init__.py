"""`trueangle blind-check`: how often the diagnosis is right on cases whose truth it cannot know.

The order is the point of it. `case_set` wishes cases, `seal` has the plants make them and hashes the truth before
anything is diagnosed, `workers` asks processes that are told two files' texts and nothing else, and only then are
the truths opened, `marks` set and `figures` made of them. `canary` looks whether the files give the truth away,
`looks` counts how often a set was seen.
"""
