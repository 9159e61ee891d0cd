"""Run a command over many scenes: plan, compute, record, resume. Knows no algorithm.

The life of a scene, from :func:`depthcli.run.runner.run_scenes`, which gets all scenes of a folder from a command:

1. *Found*: ``plan`` takes those of this process's shard (``sharing``) and refuses names and files in the way.
2. *Opened*: ``sharing`` locks the run folder, ``run_folder`` writes ``run.yaml`` or refuses the folder of another run.
3. *Digested*: ``plan.Planner`` makes a ``task.Task`` of the scene, with a digest of every file that it depends on.
4. *Resumed*: where ``record.json`` of the scene (``records``) has the same run and digests, and its files match, it is
   done, and its row is that of the record. Nothing else of an earlier run is trusted.
5. *Computed*: ``runner`` gives the other tasks to this process, to worker ``processes`` (``--jobs``), or to the workers
   of a ``cluster`` (``--scheduler``). Each calls ``task.run_task``, which calls the command's ``compute`` with an empty
   folder ``.partial-<machine>-<process>-<time>/<number>`` in the run folder. Any failure becomes a row with its reason.
6. *Written*: in the process that computed it ``install`` moves the files to ``<run folder>/<scene>``, the record last;
   it replaces what a record claims, and no other file.
7. *Reported*: the row (facts, seconds by stage, memory) goes back to ``runner``, which shows progress (``console``,
   ``progress_bar``; what workers do meanwhile comes through the memory of ``activities``) and has ``reports`` write
   ``report.json`` and ``report.csv``; the last of several processes joins their reports (``report_parts``).

A kill at any moment leaves files that one of these steps recognizes when the same command is started again.

Beside them: ``command`` is what a sub-command declares, ``cluster_worker`` what a cluster's worker runs, ``resources``
are cores and memory, ``json_csv`` writes rows, ``warning_counts`` prints each kind of warning once, ``presets`` finds
the configs that are shipped, ``combinations`` are the settings of a sweep and their effects.
"""
