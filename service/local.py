"""Computes a study in this process, without a service: the same plan, chunks, kernel and store.

    from service.local import run

    sweep = run({"gamma": {"start": 0.5, "stop": 6, "num": 111}, "omega": 0.5, "xi": 0.26})
    sweep = run("sweep.toml", store="sweep.zarr")

The service's jobs compute it, in a data folder of their own and on threads of this process: kernels run
without the interpreter's lock. So an interrupted run continues where it stopped, and a service stores the
same bytes.
"""

import errno
import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

import xarray
from pydantic import ValidationError

from kernel.numerics.cache import compilations
from kernel.params import KERNEL_VERSION
from service import budget as budgets
from service.background import InThisProcess
from service.client.dataset import from_binary
from service.client.display import display_elapsed, display_job, display_line, duration
from service.client.models import JobStatus
from service.client.specification import Specification, body
from service.errors import IllegalTransition, InvalidRequest, RunFailed, ServiceError, UnknownJob
from service.formats import EXPORTS, PICTURES, TABLES, ExportFormat
from service.jobs.manager import JobManager
from service.jobs.prepare import PreparedJob
from service.jobs.stores.opening import open_ledger
from service.ledger.ledger import Ledger
from service.ledger.model import UNFINISHED, JobRecord, JobState
from service.settings import MOST_WORKERS, Settings
from service.views import audit, exports
from service.views.difference import changed
from service.views.registry import VIEWS, admit, answer, stored
from service.views.springs import threshold
from service.views.view import Call, Query, View
from worker import store as stores
from worker.analysis.audit import is_compiled as is_compiled_for_audit
from worker.executors.inline import Inline
from worker.files import complete_file, sync
from worker.kernel_cache import use_cache
from worker.ownership import temporary_folder
from worker.spec.contact_models import CONTACT_MODELS
from worker.spec.errors import Problem, SpecInvalid, describe, rule_of
from worker.studies import from_json, renewed, study_of
from worker.sweep import SweepSpec
from worker.sweep.levels import cells, steps_of
from worker.sweep.specification import is_open
from worker.work import compile_for, is_compiled

#: Seconds between two checks of the job's progress.
LOOK_SECONDS: Final = 0.05
#: Seconds of a level beside those of its cells, at most, where nothing else is computed.
BEGINNING_SECONDS: Final = 0.3
#: Seconds that an interrupted run waits for its chunks to stop.
CANCEL_SECONDS: Final = 0.8

#: The expected time of a run is shown if it is at least this, seconds; a sample tells it where the table of
#: costs says at least SAMPLED_SECONDS.
SAID_SECONDS, SAMPLED_SECONDS = 10.0, 2.0

#: A compilation is shown after this many seconds; loading compiled kernels takes less on an idle machine.
MESSAGE_SECONDS: Final = 1.0
#: Seconds that a kernel may take to compile, and of the least budget in which an audit's kernel is compiled
#: too.
COMPILING_SECONDS, COMPILING_BUDGET = 20.0, 60.0

#: Called with the job after every check.
ProgressCallback = Callable[[JobStatus], None]


def run(
    spec: Specification,
    store: str | os.PathLike[str] | None = None,
    *,
    workers: int | None = None,
    progress: bool | ProgressCallback = True,
    budget: float | None = None,
) -> xarray.Dataset:
    """Compute a study and return its results.

    An interrupted run leaves `STORE.partial`, where the same call continues.

    Parameters
    ----------
    spec
        A mapping, a `SweepSpec`, or the path of a .json or .toml file.
    store
        Folder for the study's zarr store, which appears once complete; the Dataset then reads values when
        they are used. A complete store of the same study is returned. Without a store, the results are held
        in memory.
    workers
        Computing threads, from 1 to 1,024, by default one per core.
    progress
        As in `Job.wait`.
    budget
        Seconds in which to compute the finest level of a sweep that fits, see `service.budget`. The attribute
        `audit` of the Dataset says how many of its cells a longer computation would change.

    Returns
    -------
    xarray.Dataset
        Dims, coordinates and arrays of docs/specification.md.

    Raises
    ------
    SpecError, InvalidSpecification
        Name field and rule.
    FileExistsError, FileNotFoundError
        `store` exists and is not the store of this study, or the folder around it is missing.
    RunFailed
        A chunk could not be computed.
    DataFolderBusy
        Another process computes the same store.
    """
    computing: dict[str, Any] = {"workers": workers, "progress": progress, "budget": budget}
    if store is None:
        with temporary_folder("bounce-") as folder, computed(spec, folder, **computing) as done:
            return _opened(done.job.store_url).load().assign_attrs(done.attributes)
    attributes = run_to_store(spec, store, **computing)
    return _opened(str(Path(store).absolute())).assign_attrs(attributes)


def run_to_store(spec: Specification, store: str | os.PathLike[str], **computing: Any) -> dict[str, str]:
    """Compute a study into a folder as `computed` does; attributes of the Dataset beside the store's.

    It does not open the Dataset, which takes a second of imports.
    """
    target, attributes = Path(store), dict[str, str]()
    if (ending := target.suffix.lower().removeprefix(".")) in {*EXPORTS, *PICTURES, *TABLES}:
        raise InvalidRequest.of("store", f"is a folder of zarr, not .{ending}: run_to_file writes files")
    if not _is_computed(target, spec):
        folder = partial_of(target)
        with computed(spec, folder, **computing) as done:
            computed_store, attributes = Path(done.job.store_url), done.attributes
        computed_store.rename(target)
        sync(target.parent)
        shutil.rmtree(folder)
    return attributes


def _opened(url: str) -> xarray.Dataset:
    dataset: xarray.Dataset = xarray.open_zarr(url, consolidated=True, chunks=None)
    return dataset


def run_to_file(
    spec: Specification,
    output: str | os.PathLike[str],
    format: str,
    line: Mapping[str, Any] | None = None,
    **computing: Any,
) -> JobStatus:
    """Compute a study as `run` does and write it to a file, which appears once complete.

    Parameters
    ----------
    spec
        As in `run`.
    output
        Path of the file.
    format
        One of `service.formats.EXPORTS` for the whole study, or of the formats of the result that shows it:
        the map of a sweep over Gamma and Omega without a line, the diagram of others, the result of another
        study.
    line
        The arguments of that result's method. `along`, `gamma` or `omega` make it a diagram.
    **computing
        As in `computed`.

    Returns
    -------
    JobStatus
        The job that computed the study.

    Raises
    ------
    InvalidRequest
        The study does not have the result.
    TooLarge, NoSpace
        Also raises the errors of `run`.
    """
    use_cache()
    target, parsed = Path(output), from_json(body(spec))
    view = _shown(parsed, line or {})
    query: Query = _query(view.query, line or {})
    settings = _settings(partial_of(target))
    # check before computing for hours
    if format in EXPORTS:
        exports.check(parsed, study_of(parsed).plan(parsed), cast(ExportFormat, format))
    else:
        query, _ = admit(view, parsed, query, format, settings.max_points)
    with computed(parsed, settings.data, **computing) as done, complete_file(target) as file:
        job, study = done.job, replace(stored(done.record, done.job), audit=done.audit)
        if format in EXPORTS:
            attributes = exports.attributes_of(done.record, job)
            whole = exports.Export(
                study, job.plan, cast(ExportFormat, format), attributes=attributes, runs=done.record.runs
            )
            with exports.make(InThisProcess(), whole, settings.exports_path) as made:
                shutil.copyfileobj(made, file)
        else:
            file.write(answer(view.name, study, query, format)[0])
    shutil.rmtree(partial_of(target))
    return _status(done.record)


def _shown(spec: Any, line: Mapping[str, Any]) -> View:
    """The result that shows a study."""
    if isinstance(spec, SweepSpec):
        is_map = len(spec.axis_values("gamma")) > 1 < len(spec.axis_values("omega"))
        return VIEWS["modes" if is_map and line.keys().isdisjoint(("along", "gamma", "omega")) else "diagram"]
    return next(view for view in VIEWS.values() if view.study is not None and isinstance(spec, view.study))


def _query(model: type[Query], fields: Mapping[str, Any]) -> Query:
    """The query with these parameters. Raises InvalidRequest naming the first wrong one."""
    try:
        return model(**fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise InvalidRequest.of(str(first["loc"][0]), rule_of(first)) from None


def thresholds(omega: float, xi: float, **query: Any) -> xarray.Dataset:
    """Where one spring begins and ceases to bounce, as `Client.threshold`, in this process.

    Raises InvalidRequest naming the parameter.
    """
    use_cache()
    view = threshold.VIEW
    spring = _query(view.query, {"omega": omega, "xi": xi, **query})
    view.estimate(None, spring)
    calls: Sequence[Call] = view.parts(None, spring) if view.parts else ()
    parts = [function(*given) for function, *given in calls]
    return from_binary(answer(view.name, None, spring, "bin", parts)[0])


def partial_of(output: Path) -> Path:
    """The data folder in which an output is computed; complete results are moved from there."""
    return output.with_name(f"{output.name}.partial")


class Computed(NamedTuple):
    """A done job, and the sentence of its audit, if it has one."""

    record: JobRecord
    job: PreparedJob
    audit: str | None = None

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of a Dataset beside those of its store."""
        return {} if self.audit is None else {"audit": self.audit}


@contextmanager
def computed(
    spec: Specification,
    folder: Path,
    *,
    workers: int | None = None,
    progress: bool | ProgressCallback = True,
    budget: float | None = None,
    began: float | None = None,
) -> Iterator[Computed]:
    """Compute a study in the data folder `folder`, which is kept; yields its done job. Raises as `run`.

    began: when the budget began, by `time.monotonic`; by default now.
    """
    began = time.monotonic() if began is None else began
    threads = min(cores(), MOST_WORKERS) if workers is None else workers
    if threads not in range(1, MOST_WORKERS + 1):
        rule = f"must be a whole number from 1 to {MOST_WORKERS:,}, not {describe(threads)}"
        raise InvalidRequest.of("workers", rule)
    use_cache()
    parsed = from_json(body(spec))
    if budget is not None:
        budgets.check(parsed.protocol.kind, budget)
    settings = _settings(folder)
    folder.mkdir(mode=0o700, exist_ok=True)
    with open_ledger(settings) as ledger, closing(Inline(int(threads))) as executor:
        manager = JobManager(ledger, executor, settings)
        manager.check(parsed)
        _check_folder(ledger, parsed, folder, levels=budget is not None)
        _forget_moved(ledger, settings)
        runner = _Runner(manager, ledger, executor, settings, progress)
        with ExitStack() as stack:
            if budget is None:
                _compile(parsed, progress)
            else:
                stack.enter_context(_compiled_within(parsed, budget, began, progress))
            manager.start()
            stack.callback(manager.stop)
            if budget is None:
                if progress is True and runner.seconds(parsed) >= SAMPLED_SECONDS:
                    cost = manager.cost(parsed)
                    expected = cost.seconds_on(cost.workers)
                    if expected >= SAID_SECONDS:
                        display_line(f"expected: {duration(expected)}")
                yield runner.done(parsed)
            else:
                yield runner.within(parsed, budget, began)


class _Runner:
    """Computes studies in this process: one study, or the levels of a budget."""

    def __init__(
        self, manager: JobManager, ledger: Ledger, executor: Inline, settings: Settings,
        progress: bool | ProgressCallback,
    ) -> None:  # fmt: skip
        self._manager, self._ledger, self._executor = manager, ledger, executor
        self._is_there = settings.ledger_path.exists  # a chunk may make a folder that was moved anew
        self.seconds, self.is_done, self.took = manager.seconds, manager.is_done, manager.took
        self._progress = progress
        self._levels: list[Computed] = []
        self._took = 0.0  # seconds, of the last level

    def done(self, spec: Any, deadline: float = math.inf) -> Computed:
        """Compute a study; its done job. Raises as `_wait`."""
        record = self._wait(self._manager.submit(spec).job.id, deadline)
        return Computed(record, self._manager.preparer.prepare(record))

    def within(self, spec: Any, budget: float, began: float) -> Computed:
        """Compute the finest level that fits into the budget."""

        def show(text: str, left: float) -> None:
            if self._progress is True:
                display_line(f"{text}, {left:.0f} s left" if left else text)

        with self._ledger.reading() as reading:
            done = [renewed(job.spec) for job in reading.search() if job.state is JobState.DONE]
        levels = [steps for each in done if (steps := steps_of(spec, each))]
        known = max(levels, key=partial(cells, spec), default=None)
        answer = budgets.within(spec, budget, self, show, began=began, known=known)
        return self._levels[-1]._replace(audit=answer.audit)

    def compute(self, spec: Any, seconds: float) -> bool:
        now = time.monotonic()
        try:
            self._levels.append(self.done(spec, now + seconds))
        except (TimeoutError, ServiceError) as error:
            if not self._levels and (fault := self._manager.fault()):
                raise RunFailed(fault) from error
            if not self._levels and not isinstance(error, TimeoutError):
                raise
            return False
        self._took = time.monotonic() - now
        return True

    def changed(self) -> float | None:
        with suppress(OSError, stores.StoreError):
            before, last = (stored(level.record, level.job) for level in self._levels[-2:])
            return changed(last, before)
        return None

    def audit(self, seconds: float) -> str | None:
        deadline = time.monotonic() + seconds
        study = stored(self._levels[-1].record, self._levels[-1].job)
        workers = self._executor.state().workers
        # as a machine is that computes other things, too
        slower = max(self._took / (self.seconds(study.spec) + BEGINNING_SECONDS), 1.0)
        query = audit.affordable(study.spec, seconds * workers / slower)
        # Compiling cannot be interrupted.
        if query is None or not (seconds > COMPILING_SECONDS or audit.is_compiled(study)):
            return None
        calls = [self._executor.call(*call) for call in audit.parts(study, query)]
        _, late = wait(calls, timeout=max(deadline - time.monotonic(), 0.0))
        for call in late:
            call.cancel()
        if late:
            return None
        return str(audit.compute(study, query, *(call.result() for call in calls)).attrs["sentence"])

    def _wait(self, job_id: str, deadline: float) -> JobRecord:
        """Wait until a job is done; its record. Raises RunFailed, and TimeoutError after `deadline`.

        If interrupted, it cancels the job, so that its chunks stop. Stored results stay.
        """
        find, record = self._ledger.find, None
        try:
            with display_job(self._progress) as show:
                while self._is_there() and (record := find(job_id)) is not None:
                    show(_status(record))
                    if record.state not in UNFINISHED:
                        break
                    if time.monotonic() > deadline:
                        raise TimeoutError
                    time.sleep(LOOK_SECONDS)
        except BaseException:
            with suppress(IllegalTransition, UnknownJob):
                self._manager.cancel(job_id)
                deadline = time.monotonic() + CANCEL_SECONDS
                while (job := find(job_id)) and job.state in UNFINISHED and time.monotonic() < deadline:
                    time.sleep(LOOK_SECONDS)
            raise
        if record is None or not self._is_there():
            raise RunFailed("the folder of the run was moved, removed or changed while it computed")
        if record.state is not JobState.DONE:
            raise RunFailed(record.error or f"the study was {record.state}")
        return record


def _check_folder(ledger: Ledger, spec: Any, folder: Path, *, levels: bool) -> None:
    """Raise FileExistsError for a folder with another study, whose results would be removed.

    levels: whether levels of the study may be there.
    """

    def belongs(other: Any) -> bool:
        if levels and isinstance(spec, SweepSpec) and isinstance(other, SweepSpec):
            return steps_of(spec, other) is not None
        return bool(other.canonical() == spec.canonical())

    with ledger.reading() as reading:
        others = [job for job in reading.search() if not belongs(renewed(job.spec))]
    if others:
        rule = "holds a run of another specification; remove it first"
        raise FileExistsError(errno.EEXIST, rule, str(folder))


def _forget_moved(ledger: Ledger, settings: Settings) -> None:
    """Forget the done job whose store an interrupted run moved to its output: that was removed since."""
    with ledger.writing() as writing:
        for job in writing.search():
            if job.state is JobState.DONE and not Path(settings.store_of(job.store)).exists():
                writing.delete(job)


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _settings(folder: Path) -> Settings:
    """The default settings for a data folder, ignoring BOUNCE_* variables."""
    return Settings.model_construct(data=folder.absolute())


def _compile(spec: Any, progress: bool | ProgressCallback) -> None:
    """Compile a study's kernels in one thread rather than in all workers at once; can be interrupted."""
    if is_open(spec):  # choosing the model compiles
        return
    # in a thread: the compiler blocks Python for seconds, and may lose an exception
    thread = ThreadPoolExecutor(1, thread_name_prefix="compile")
    compiled = thread.submit(compile_for, spec)
    while not wait([compiled], LOOK_SECONDS).done:
        if progress is True and any(time.time() - x.began > MESSAGE_SECONDS for x in compilations()):
            with display_elapsed(_compiling(spec)):
                wait([compiled])
    compiled.result()
    thread.shutdown(wait=False)


def _compiling(spec: Any) -> str:
    return f"compiling the {CONTACT_MODELS[spec.model.kind].label}, or loading it from the cache"


@contextmanager
def _compiled_within(
    spec: Any, budget: float, began: float, progress: bool | ProgressCallback
) -> Iterator[None]:
    """As `_compile`, within a budget; from COMPILING_BUDGET on, compile for its audit beside the block.

    Another process compiles, as that can be ended. Raises SpecInvalid if the time is over before.
    """
    audited, seconds = budget >= COMPILING_BUDGET, budgets.usable(budget, time.monotonic() - began)
    if is_open(spec) or (is_compiled(spec) and not (audited and not is_compiled_for_audit(spec, None))):
        _compile(spec, progress)
        yield
        return
    command = [sys.executable, "-P", "-m", "worker.analysis.audit"]
    started = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    with started as process, ThreadPoolExecutor(1) as thread:
        try:
            asked = thread.submit(_ask, process, json.dumps(spec.as_submitted()))
            with display_elapsed(_compiling(spec), MESSAGE_SECONDS) if progress is True else nullcontext():
                in_time = wait([asked], max(seconds, 0.0)).done
            if not in_time:
                enough = max(2.0 * max(budget, time.monotonic() - began), COMPILING_BUDGET)
                rule = f"was over before the {CONTACT_MODELS[spec.model.kind].label} was compiled"
                raise SpecInvalid([Problem("budget", f"{rule}; {enough:.0f}s may work")])
            if not audited:
                process.kill()
            _compile(spec, False if asked.result() else progress)
            yield
        finally:
            process.kill()


def _ask(process: "subprocess.Popen[str]", spec: str) -> str:
    """The first line of a process that reads a specification; "" if it ends without one."""
    assert process.stdin is not None
    assert process.stdout is not None
    with suppress(OSError):  # the input stays open: the process ends with it
        print(spec, file=process.stdin, flush=True)
    return process.stdout.readline()


def _is_computed(target: Path, spec: Specification) -> bool:
    """Whether `target` is the study's complete store; False if it does not exist.

    Raises FileExistsError if it is anything else, FileNotFoundError without the folder around it.
    """
    if not target.exists() and not target.is_symlink():
        if not target.absolute().parent.is_dir():
            raise FileNotFoundError(errno.ENOENT, "there is no such folder", str(target.absolute().parent))
        return False
    parsed, attrs = from_json(body(spec)), dict[str, Any]()
    with suppress(stores.StoreError):
        attrs = stores.read_attrs(str(target.absolute()))
    if attrs.get("job") == parsed.job_id(KERNEL_VERSION):
        return True
    rule = "exists, and is not the store of this study, but perhaps a level of it"
    if (version := attrs.get("kernel_version", KERNEL_VERSION)) != KERNEL_VERSION:
        rule = f"exists, and kernel version {version} computed it; this is version {KERNEL_VERSION}"
    raise FileExistsError(errno.EEXIST, rule, str(target))


def _status(record: JobRecord) -> JobStatus:
    started = record.started and datetime.fromtimestamp(record.started, UTC).isoformat()
    fields = {"id": record.id, "name": record.name, "state": str(record.state), "error": record.error}
    status = JobStatus()
    status._update({**fields, "started": started, "progress": record.progress(time.time())})
    return status
