"""The work of a study: a graph of pure functions with content keys.

In: a study and its cases. Out: files under their keys: meshes, answers and limits in the cache, cases in the run
directory. What has its file there, and sound, is no task.

keys          what has the same key is the same work
plan          the cases of a study, what each wants, and what is there
tasks         the work that is missing, each piece after those that it needs
pool          does tasks in processes here, or on a cluster (cluster)
worker        what each kind of task does; of a case (case), of its limits (small_strain)
cache         answers as files under their keys
run           a plan done: locks, tasks, failures, report
explain       what a plan says, refuses, and doubts
provenance    where a case comes from
"""
