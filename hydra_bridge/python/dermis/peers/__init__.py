"""Other renderers on the same work: Mitsuba 3 and Cycles render what `dermis flatten` wrote.

environments: virtual environments of their own, and how to make them; flat_file: the flattened scene; appearance,
geometry: what it means; mitsuba_export, cycles_export: in the words of each peer; client: a peer at work in a process
of its own, which runs mitsuba_worker or cycles_worker.
"""
