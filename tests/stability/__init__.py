"""The hard cases: rows of stress, expectation and measurement. `make stability` runs them all into one report.

    PYTHONPATH=tests python -m stability [--out DIR] [--only WORD] [--quick]

A family of rows is a module with `CASES`; `row` says when a row holds.
"""
