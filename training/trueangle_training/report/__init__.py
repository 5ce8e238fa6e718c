"""The calibration report: one HTML file with everything that must be known of a model before it is used.

Reading order: inputs (what goes in), served (the model file asked by ONNX Runtime), residuals, harmonics, budget,
cautions (plain-word warnings), compared (compare.json), plots, writing.
"""
