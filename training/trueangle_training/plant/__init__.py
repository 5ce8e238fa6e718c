"""Plants: campaigns whose truth is known, made without anything of effects, simulator or diagnosis.

What all plants share lies here and holds no physics: the wish for a case, the operator's plan, the files, and the
judge of what a plan lets anyone see. Each plant is a package of its own that imports nothing of the others:
`reading_head` (A) the exact geometry of a head over a grating, `mechanical` (B) friction, compliance and heat
stepped in time, `metrological` (C) a grating of single lines on a bench with an imperfect reference.
"""
