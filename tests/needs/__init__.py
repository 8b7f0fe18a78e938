"""What capabilities cost, in use and not: minimal stages (stages, capabilities), measured (driver, measure).

`make needs` runs it and writes the table that `dermis explain` and the reports show.
"""
