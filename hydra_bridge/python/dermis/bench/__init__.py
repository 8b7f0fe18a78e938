"""Speed against error: `dermis bench` renders crops of stages by several methods and compares each to a reference.

methods, crops, suite, spec: what is compared; scenes, reference, render, store: pictures and their cost; runner: in
which order; measures, results: what they say; table, plots, figure, page, report: how it is shown.
"""
