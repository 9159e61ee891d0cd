"""Run a command over many scenes: plan, compute, record, resume. Knows no algorithm.

``runner`` goes through the scenes of a run; ``task`` computes one of them, here, in worker ``processes`` or on a
``cluster``. ``records`` says of a scene what it was made from and which files are its own; ``run_folder`` is the
folder of a run and its config; ``report_writer`` writes ``report.json`` and ``report.csv``. ``sharing`` divides scenes
among shards and locks the folder; ``dry_run`` says what a run would do; ``sweep`` makes the configs of a sweep;
``console`` is what people read; ``command`` is what a sub-command declares.
"""
