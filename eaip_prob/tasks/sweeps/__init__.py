"""Studies over many conditions on the cursor task: how people's timing varies, and how few demonstrations suffice.

A condition is a `Part` whose configuration holds everything that its result depends on; its result is scores on the
future of test motions (`measuring`). `timing` and `few_demonstrations` say which conditions there are and what becomes
of their results; `charts` draws, records and tabulates either.
"""
