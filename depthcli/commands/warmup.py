"""Compile the kernels of presets before their first run."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.run.batch import SOME_FAILED
from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter, aligned
from depthcli.run.json_csv import to_json

if TYPE_CHECKING:
    from depthcli.kernels.calls import KernelCall


class WarmupCommand(Command):
    """Compiles kernels, or lists them with the time that it takes."""

    arguments = (
        Option("presets", str, "Presets, as COMMAND/NAME or COMMAND (all of it).", "PRESET...", repeatable=True,
               group="Input"),
    )  # fmt: skip

    options = (
        Option("all", bool, "Every preset.", default=False, group="Input"),
        Option("list", bool, "List the kernels and their times; compile none.", default=False, group="Run"),
        Option("jobs", int, "Processes side by side. Default: one per core.", "N", short="-j", min_value=1,
               group="Run"),
    )  # fmt: skip

    examples = ("depthcli warmup stereo/accurate fuse", "depthcli warmup --all --jobs 4")

    def run(self, values: Values, reporter: Reporter) -> int:
        """Compile or list; return the exit code."""
        from depthcli.kernels.calls import recorded_calls
        from depthcli.kernels.jit import cache_folder
        from depthcli.run.resources import cores

        presets = _chosen(values["presets"] or [], values["all"] or (values["list"] and not values["presets"]))
        calls = recorded_calls(presets)
        if values["list"]:
            if values["json"]:
                reporter.data(to_json([call._asdict() for call in calls]))
            else:
                total = sum(call.seconds for call in calls)
                rows = [(f"{call.module}.{call.kernel}", _arguments(call), f"{call.seconds:.2f}") for call in calls]
                footer = (f"{len(calls)} kernels", "", f"{total:.2f}")
                reporter.data(aligned([("kernel", "arguments", "seconds"), *rows, footer]))
            return 0
        if cache_folder() is None:
            raise ConfigError("no folder for compiled kernels can be written; name one in NUMBA_CACHE_DIR")
        n_compiled, failed = _prepare(calls, values["jobs"] or cores(), reporter)
        for line in failed:
            reporter.error(line)
        if values["json"]:
            reporter.data(to_json({"kernels": len(calls), "compiled": n_compiled, "failed": failed}))
        else:
            reporter.info(f"{len(calls)} kernels of {len(presets)} presets: {n_compiled} compiled, in {cache_folder()}")
        return SOME_FAILED if failed else 0


def _chosen(words: list[str], every: bool) -> list[str]:
    """Return the presets, as ``command/name``, and the commands without presets, that the words name."""
    from depthcli.kernels.calls import recorded_presets
    from depthcli.run.presets import list_presets, preset_of

    without = [name for name in recorded_presets() if "/" not in name]
    chosen = [*(f"{command}/{name}" for command, name, _ in list_presets()), *without] if every else []
    for word in words:
        command, _, name = word.partition("/")
        found = [f"{word}/{each}" for _, each, _ in list_presets(word)]
        found += [word] if word in without else []
        found += [preset] if (preset := preset_of(command, name)) else []
        if not found:
            raise ConfigError(f"no preset {word!r}; give COMMAND/NAME (see depthcli presets), COMMAND, or --all")
        chosen += found
    if not chosen:
        raise ConfigError("name presets, such as stereo/accurate, or give --all")
    return sorted(set(chosen))


def _arguments(call: KernelCall) -> str:
    return ", ".join(each if isinstance(each, str) else each[0].rpartition(":")[2] for each in call.arguments)


def _prepare(calls: list[KernelCall], n_processes: int, reporter: Reporter) -> tuple[int, list[str]]:
    """Load or compile all kernels; return how many were compiled, and a line for each that cannot be."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool

    # The kernels of one module share helpers: in one process, these are compiled once.
    modules: dict[str, list[KernelCall]] = defaultdict(list)
    for call in calls:
        modules[call.module].append(call)
    longest_first = sorted(modules.values(), key=lambda group: -sum(call.seconds for call in group))
    n_processes = max(1, min(n_processes, len(modules)))  # some presets have no kernels
    n_compiled, failed = 0, []
    with reporter, ProcessPoolExecutor(n_processes, multiprocessing.get_context("spawn")) as pool:
        reporter.start(len(calls), 0, "compiling", unit="kernel")
        pending = {pool.submit(_prepare_module, group): group for group in longest_first}
        for future in as_completed(pending):
            try:
                count, lines = future.result()
            except BrokenProcessPool as error:
                raise ConfigError(
                    "a process that compiled kernels was ended from outside (memory?); try --jobs 1"
                ) from error
            n_compiled += count
            failed += lines
            for _ in pending[future]:
                reporter.step()
    return n_compiled, failed


def _prepare_module(calls: list[KernelCall]) -> tuple[int, list[str]]:
    n_compiled, failed = 0, []
    for call in calls:
        try:
            n_compiled += call.prepare()[0] > 0
        except (AttributeError, ImportError, ValueError, TypeError) as error:
            failed.append(f"{call.module}.{call.kernel}: cannot be compiled ({error})")
    return n_compiled, failed


COMMAND = WarmupCommand()
