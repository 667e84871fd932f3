"""From a job to its results: build the objects, drive the searches, compare the sets.

The driver does not use Ray. It hands tasks to a pool and takes the outcomes in any order.
"""
