"""The work of a study: a graph of pure functions with content keys.

In: a study and its cases. Out: files under their keys: meshes, answers and limits in the cache, cases in the run
directory. Work with a sound file there is no task.

keys          content keys: equal keys are equal work
plan          the cases of a study, their needs, and the existing files
tasks         the missing work, each piece after those that it needs
pool          does tasks in processes here, or on a cluster (cluster)
worker        the kinds of tasks; those of a case (case) and of its limits (small_strain)
cache         answers as files under their keys
run           a plan from start to end: locks, tasks, failures, report
explain       a plan in words, with refusals and doubts
provenance    the origin of a case
"""
