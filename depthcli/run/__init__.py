"""Run a command over many scenes: skip finished scenes, compute the rest, record, report.

:func:`depthcli.run.runner.run_scenes` gets a ``Job`` and its scenes from a command:

1. ``folder`` locks the run folder, writes ``run.yaml``, or refuses the folder of another config.
2. ``runner`` digests every file that the scene depends on. If ``record.json`` of the scene (``records``) has the
   same run and digests, and its files match, it is done, and its row comes from the record.
3. ``workers`` compute the others here or in processes (``--jobs``), ``cluster`` on dask (``--scheduler``).
4. ``scene`` is the way of a scene there: it gives the command an empty hidden folder in the run folder, and moves the
   files to ``<run folder>/<scene>``, the record last. Any failure becomes a row with its reason.
5. ``runner`` writes ``report.json`` and ``report.csv`` from the records, whenever a process of the run ends.

If a run is killed, the same command recognizes its files and resumes.

Others: ``job`` is the interface of a command, and the options, cores and memory of a run, ``console`` the output on the
terminal, ``flags`` the conditions of ``--flag``.
"""
