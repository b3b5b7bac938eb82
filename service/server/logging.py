"""The process's log on standard error: lines to read on a terminal, elsewhere one JSON object per line."""

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any, Final

#: The project's own loggers, whose level is a setting.
_OWN: Final = ("service", "worker")

#: Libraries that configure their own handlers; their warnings go through the root logger instead.
_LIBRARIES: Final = ("distributed", "tornado", "bokeh", "uvicorn", "asyncio")


class JsonLines(logging.Formatter):
    """Formats a record as one line of JSON; `extra={"fields": {...}}` adds members."""

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


class ReadableLines(logging.Formatter):
    """Formats a record as a line for people: time, level unless it is info, and what happened."""

    def format(self, record: logging.LogRecord) -> str:
        """The line, with a traceback below it."""
        level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        fields = {name: value for name, value in getattr(record, "fields", {}).items() if name != "id"}
        facts = ", ".join(f"{name} {value}" for name, value in fields.items())
        line = f"{datetime.fromtimestamp(record.created):%H:%M:%S} {level}{record.getMessage()}"
        trace = f"\n{self.formatException(record.exc_info)}" if record.exc_info else ""
        return f"{line}{f' ({facts})' if facts else ''}{trace}"


def _library_loggers() -> list[logging.Logger]:
    names = list(logging.root.manager.loggerDict)
    return [logging.getLogger(name) for name in names if name.partition(".")[0] in _LIBRARIES]


def quiet_libraries() -> None:
    """Drop libraries' messages about connections that end because the process does."""
    for logger in _library_loggers():
        logger.disabled = True


@contextmanager
def log_to_stderr(level: str) -> Iterator[None]:
    """Write the log to standard error during the block; `level` applies to the project's loggers."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(ReadableLines() if sys.stderr.isatty() else JsonLines())
    root = logging.getLogger()
    root.addHandler(handler)
    for name in _OWN:
        logging.getLogger(name).setLevel(level.upper())
    for logger in _library_loggers():
        logger.handlers.clear()
        logger.propagate = True
        logger.setLevel(max(logger.level, logging.WARNING))
    logging.captureWarnings(True)
    try:
        yield
    finally:
        logging.captureWarnings(False)
        root.removeHandler(handler)
        for name in _OWN:
            logging.getLogger(name).setLevel(logging.NOTSET)
