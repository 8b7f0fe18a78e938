"""usdrecord's looks into USD itself: `--traceToFile` and `--memstats`."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pxr import Tf


@contextmanager
def recording(args: argparse.Namespace) -> Iterator[None]:
    """Traces and accounts memory while inside, as the flags ask; reports at the end, also after an error."""
    if args.memstats:
        Tf.MallocTag.Initialize()
    collector = None
    if args.traceToFile:
        from pxr import Trace

        collector = Trace.Collector()
    if collector:
        collector.enabled = True
    try:
        yield
    finally:
        if collector:
            collector.enabled = False
            write_trace(args.traceToFile, args.traceFormat)
        if args.memstats:
            print(memory_report(Path(args.usdFilePath).name))


def write_trace(file: str, form: str) -> None:
    from pxr import Trace

    reporter = Trace.Reporter.globalReporter
    if form == "trace":
        reporter.Report(file)
    else:
        reporter.ReportChromeTracingToFile(file)


def memory_report(name: str) -> str:
    """Writes the call tree of allocations to a file; says where, and the sum."""
    if not Tf.MallocTag.IsInitialized():
        return "Unable to accumulate memory usage since the Pxr MallocTag system was not initialized"
    import tempfile

    with tempfile.NamedTemporaryFile(prefix=f"{name}.", suffix=".mallocTag", delete=False) as file:
        pass
    Tf.MallocTag.GetCallTree().Report(file.name)
    megabytes = Tf.MallocTag.GetTotalBytes() / (1024.0 * 1024.0)
    return (
        f"Memory consumption of dermis record for {name} is {megabytes:.0f} Mb\n"
        f"For detailed analysis, see {file.name}"
    )
