"""Speed against error: `dermis bench` renders crops of stages by several methods and compares each to a reference.

methods, crops, suite: what is compared; scenes, render, reference: pictures and their cost; measures, results,
table, pictures, plots: what they mean.
"""
