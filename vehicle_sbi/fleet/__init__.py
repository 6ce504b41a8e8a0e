"""Many vehicles at once: what lies in a folder, a diagnosis of each in a process of its own, and one table of them all.

    folder -> vehicles -> jobs, on an engine -> run folders -> table, index page

An engine is this machine or a Dask cluster. A job is files and the words of a command line, so where it runs changes no
number, and what stands on disk is not done again.
"""
