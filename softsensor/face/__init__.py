"""What `softsensor` offers from Python, a module a question; each loads only what its answer needs.

Everything takes what is at hand: a run as a file's path, a table or a `Run`; a press as a file's path or a
`Press`; a model as a file's path, a `ModelFile`, or the result of a fit or a diagnosis. Errors are those of the
command line.

What it hands out cannot be changed: results, runs with their headers and columns, and the mappings and arrays of
what a result is about (`FitResult.campaign` and its runs, `Simulation.simulated`); the tables, lists and JSON that
a method returns are made anew each time. Deeper down, where a fit keeps its solver (``problem``, ``minimum``,
``model``), nothing is promised. Results and runs are equal only if they are the same object, and can be keys.
"""
