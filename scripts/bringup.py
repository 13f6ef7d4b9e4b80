# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Run the whole graph: sensor, detectors, trackers and evaluator, to a table of scores."""

import argparse
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import fields
import os
from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from _arguments import command_line
from _arguments import CONFIG
from _arguments import INTERRUPTED
from _arguments import RESULTS
from _arguments import shown_path
from _arguments import USAGE
import _environment
from _film_arguments import films
from _network import opened
from _network import secure
from _network import set_environment
from _run_arguments import extras_of
from _run_arguments import modules_of
from _run_arguments import parse_arguments
from _run_arguments import print_parameters
from ros2 import line_to_copy

if TYPE_CHECKING:
    from lowsnr_bringup.plan.parts import Part
    from lowsnr_bringup.plan.recorded_frames import RecordedRun
    from lowsnr_bringup.plan.run_plan import RunPlan
    from lowsnr_bringup.run.forked_nodes import NodeServer
    from lowsnr_bringup.run.results_folder import Account
    from lowsnr_bringup.run.stop_signals import StopSignals
    from lowsnr_detect.calibration.curve import Calibration
    from lowsnr_detect.parts.detector import Detector


def main() -> int:
    """Start the server of nodes, which imports while the run is planned, and run."""
    options = parse_arguments(sys.argv[1:])
    _environment.ensure(extras_of(options))
    if options.list:
        from lowsnr_bringup.plan.config_files import describe_parameters
        from lowsnr_bringup.plan.config_files import load_config
        print_parameters(describe_parameters(load_config(CONFIG), options.detectors))
        return 0
    set_environment(options)
    from lowsnr_bringup.run.forked_nodes import NodeServer
    from lowsnr_bringup.run.stop_signals import StopSignals
    with StopSignals() as stop, NodeServer(*modules_of(options)) as server:
        return plan_and_run(options, stop, server)


def plan_and_run(
    options: argparse.Namespace, stop: 'StopSignals', server: 'NodeServer',
) -> int:
    """Plan the run, claim its domain and folder, calibrate, and run; return the exit code."""
    from lowsnr_bringup.plan.confirmation import confirm_at_rate
    from lowsnr_bringup.plan.parts import part_of
    from lowsnr_bringup.run.domain import claim_domain
    from lowsnr_bringup.run.results_folder import fresh_folder
    with ExitStack() as stack:
        try:
            notes = opened(options.peers)
            made = films(options, Path(stack.enter_context(TemporaryDirectory())))
            plan = plan_of(options)
            part = part_of(plan.nodes, plan.parameters, options.only, options.expect)
            claim = stack.enter_context(claim_domain(shared=bool(part.expected)))
            if options.secure is not None:
                secure(options.secure, [node.enclave for node in part.own], part.manager)
            folder = fresh_folder(
                options.results or RESULTS / '-'.join(filter(None, [plan.name, part.label])))
            space = next(iter(plan.detectors)).rpartition('/')[0]
            line = line_to_copy('topic', 'echo', f'{space}/tracks')  # before the nodes' profile
            say(*confirm_at_rate(plan, say))
            write_parameters(plan, folder, part.evaluates)
        except (OSError, ValueError) as error:
            say(str(error))
            return USAGE
        say(*made, *plan.notes, *notes)
        calibrate(plan, part)
        if plan.frames is None:
            print(f'to see the tracks, in another terminal:\n{line}', flush=True)
        return run(options, plan, part, folder, stop, server, claim.fileno())


def plan_of(options: argparse.Namespace) -> 'RunPlan':
    """Return the checked plan of the run that the options ask for."""
    from lowsnr_bringup.plan.run_options import RunOptions
    from lowsnr_bringup.plan.run_plan import plan_run

    def look(topic: str) -> 'RecordedRun':
        from lowsnr_bringup.plan.graph import MANAGER
        from lowsnr_bringup.ros.camera import inspect_camera
        if options.secure is not None:
            secure(options.secure, [], MANAGER)
        return inspect_camera(topic, options.camera_within)

    return plan_run(
        RunOptions(**{item.name: getattr(options, item.name) for item in fields(RunOptions)}),
        CONFIG, look)


def calibrate(plan: 'RunPlan', part: 'Part') -> None:
    """Find the thresholds of matched detectors here, where progress can be shown."""
    # The threshold is found where the detector or a tile of it runs; the merger has none.
    own = {f'{node.namespace}/{node.section}' for node in part.own if not node.merges}
    for path, detector in plan.detectors.items():
        values = plan.parameters[path]
        if path in own and values['operating_point'] == 'matched':
            calibrate_detector(
                path, detector, values['false_alarm_prob'], (values['rows'], values['cols']), say)


def calibrate_detector(
    name: str, detector: 'Detector', prob: float, shape: tuple[int, int],
    warn: Callable[[str], None],
) -> 'Calibration':
    """Return the calibration; show the progress if it takes more than half a second."""
    from lowsnr_bringup.run.progress import calibration_progress
    from lowsnr_detect.calibration.operating_point import calibrated

    with calibration_progress(name, shape, detector.sensor.snr_db) as show:
        return calibrated(detector, prob, shape, progress=show, warn=warn)


def write_parameters(plan: 'RunPlan', folder: Path, evaluates: bool) -> None:
    """Write what every node of the run reads; reserve room for the summary of an evaluator."""
    from lowsnr_bringup.plan.config_files import to_yaml
    from lowsnr_bringup.run import results_folder
    from lowsnr_bringup.run.middleware import middleware_environment
    from lowsnr_eval.scoring.final_summary import reserve_summary
    import rclpy

    file = (folder / results_folder.PARAMETERS_FILE).resolve()
    plan.parameters['/evaluator']['results'] = str(folder.resolve())
    if '/recorder' in plan.parameters:
        plan.parameters['/recorder']['run_parameters'] = str(file)
    try:
        os.environ |= middleware_environment(
            os.environ, folder, rclpy.get_rmw_implementation_identifier())
        file.write_text(to_yaml(plan.parameters), encoding='utf-8')
        if evaluates:
            reserve_summary(folder, len(plan.detectors))
        else:
            (folder / results_folder.FRAMES_FILE).unlink()  # the folder is not empty any more
    except OSError as error:
        raise results_folder.cannot_write(folder, error) from None


def run(options: argparse.Namespace, plan: 'RunPlan', part: 'Part', folder: Path,
        stop: 'StopSignals', server: 'NodeServer', claim: int) -> int:
    """Start the graph, wait for its end, and present what it scored; return the exit code."""
    from lowsnr_bringup.ros.domain_guard import DomainTaken
    from lowsnr_bringup.ros.supervisor import Supervisor

    shown = shown_path(folder, options.results)
    supervisor = Supervisor(
        part, folder, plan.frames, plan.parameters['/evaluator']['answer_within_s'], stop,
        claim, plan.respawn, server=server, expect_within_s=options.expect_within)
    with stop.deferred():
        try:
            status, trouble = supervisor.run()
        except DomainTaken as error:
            shutil.rmtree(folder)  # it holds nothing but what this run made
            say(str(error))
            return USAGE
        faults = present(plan, folder, supervisor.account) if part.evaluates else []
        say(*faults, *filter(None, [supervisor.results.fault if faults else '', trouble]))
        print(f'{"results" if part.evaluates else "logs of this part"} in {shown}')
        status = status or int(bool(faults))
    try:
        if stop.count < 2 and part.evaluates:
            present_by_products(plan, folder, shown)
    except KeyboardInterrupt:
        status = status or INTERRUPTED
    return status


def present(plan: 'RunPlan', folder: Path, account: 'Account') -> list[str]:
    """Sum up the scores, write and print them; return what is missing, a line for each kind."""
    from lowsnr_common.settings.text import one_line
    from lowsnr_eval.report.table import format_table
    from lowsnr_eval.scoring.final_summary import missing_frames
    from lowsnr_eval.scoring.final_summary import summarize_run
    from lowsnr_eval.scoring.final_summary import write_summary

    try:
        summary = summarize_run(folder, plan.parameters['/evaluator'], account)
    except (OSError, ValueError) as error:
        return [f'no summary: {one_line(error)}']
    if summary is None:
        return ['nothing was scored']
    faults = missing_frames(summary['frames'])
    try:
        write_summary(folder, summary)
    except ValueError as error:
        faults.append(f'no summary: {error}')
    print(format_table(summary))
    return faults


def present_by_products(plan: 'RunPlan', folder: Path, shown: str) -> None:
    """Print what was recorded, add the metrics of tracks, and write the report."""
    from lowsnr_bringup.run.results_folder import SUMMARY_FILE
    from lowsnr_eval.report.table import false_track_lines
    from lowsnr_eval.track_metrics.metrics_table import short_metrics
    from lowsnr_eval.track_metrics.run_metrics import add_track_metrics
    if '/recorder' in plan.parameters:
        from lowsnr_bringup.bags import recording
        for bag in recording.bags_of_run(Path(plan.parameters['/recorder']['bag'])):
            print(recording.summarize_recording(bag))
    if (folder / SUMMARY_FILE).is_file():
        say(*add_track_metrics(folder))
        print(*false_track_lines(folder), short_metrics(folder), sep='', end='')
        report(folder, shown)


def report(folder: Path, shown: str) -> None:
    """Write the page that shows the run; scores do not depend on it."""
    from lowsnr_common.settings.text import one_line
    from lowsnr_eval.report.run_report import write_run_report

    command = command_line('bringup', sys.argv[1:])
    try:
        print(f'report: {os.path.join(shown, write_run_report(folder, command).name)}')
    except (OSError, ValueError) as error:
        say(f'no report: {one_line(error)}')


def say(*texts: str) -> None:
    """Print lines for the user, apart from the table of scores."""
    from lowsnr_common.settings.text import printable_lines

    for text in texts:
        print(f'bringup.py: {printable_lines(text)}', file=sys.stderr)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
