"""Run the whole graph: sensor, detectors, trackers and evaluator, to a table of scores."""

import argparse
from contextlib import ExitStack
from dataclasses import fields
import json
import os
from pathlib import Path
import shlex
import shutil
import sys
from typing import TYPE_CHECKING

from _arguments import INTERRUPTED
from _arguments import USAGE
import _environment
from _run_arguments import parse_arguments

if TYPE_CHECKING:
    from lowsnr_bringup.bags.recorded_run import RecordedRun
    from lowsnr_bringup.plan.run_plan import RunPlan
    from lowsnr_bringup.run.forked_nodes import NodeServer
    from lowsnr_bringup.run.results_folder import Account
    from lowsnr_detect.calibration.curve import Calibration
    from lowsnr_detect.parts.detector import Detector

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / 'config'


def main() -> int:
    """Start the server of nodes, which imports while the run is planned, and run."""
    _environment.ensure()
    options = parse_arguments(sys.argv[1:])
    set_environment(options)
    from lowsnr_bringup.run.forked_nodes import NodeServer
    with NodeServer() as server:
        return plan_and_run(options, server)


def plan_and_run(options: argparse.Namespace, server: 'NodeServer') -> int:
    """Plan the run, claim its domain and folder, calibrate, and run; return the exit code."""
    from lowsnr_bringup.run.domain import claim_domain
    from lowsnr_bringup.run.middleware import middleware_environment
    from lowsnr_bringup.run.results_folder import fresh_folder
    import rclpy
    with ExitStack() as claim:
        try:
            plan = plan_of(options)
            claim.enter_context(claim_domain())
            if options.secure is not None:
                secure(options.secure, [node.path for node in plan.nodes])
            folder = fresh_folder(options.results or ROOT / 'results' / plan.name)
            os.environ |= middleware_environment(
                os.environ, folder, rclpy.get_rmw_implementation_identifier())
        except ValueError as error:
            say(str(error))
            return USAGE
        for note in plan.notes:
            say(note)
        calibrate(plan)
        write_parameters(plan, folder)
        return run(plan, folder, server)


def set_environment(options: argparse.Namespace) -> None:
    """Set the ROS domain and how far it reaches, for this process and all nodes."""
    if not os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE'):  # ROS takes an empty one for SUBNET
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if options.domain_id is not None:
        os.environ['ROS_DOMAIN_ID'] = str(options.domain_id)


def plan_of(options: argparse.Namespace) -> 'RunPlan':
    """Return the checked plan of the run that the options ask for."""
    from lowsnr_bringup.plan.run_options import RunOptions
    from lowsnr_bringup.plan.run_plan import plan_run

    def look(topic: str) -> 'RecordedRun':
        from lowsnr_bringup.ros.camera import inspect_camera
        if options.secure is not None:
            secure(options.secure, [])
        return inspect_camera(topic, options.camera_within)

    return plan_run(
        RunOptions(**{item.name: getattr(options, item.name) for item in fields(RunOptions)}),
        CONFIG, look)


def secure(keystore: Path, nodes: list[str]) -> None:
    """Make all nodes that start from here on enforce security, each in its own enclave."""
    from lowsnr_bringup.plan.graph import MANAGER
    from lowsnr_bringup.ros.bringup_node import check_security
    from lowsnr_bringup.run.security import secured_environment

    os.environ |= secured_environment(keystore, [f'/{MANAGER}', *nodes], os.environ)
    check_security()


def calibrate(plan: 'RunPlan') -> None:
    """Find the thresholds of matched detectors here, where progress can be shown."""
    for path, detector in plan.detectors.items():
        values = plan.parameters[path]
        if values['operating_point'] == 'matched':
            calibrate_detector(
                path, detector, values['false_alarm_prob'], (values['rows'], values['cols']))


def calibrate_detector(
    name: str, detector: 'Detector', prob: float, shape: tuple[int, int],
) -> 'Calibration':
    """Return the calibration; show the progress if it takes more than half a second."""
    from lowsnr_bringup.run.progress import progress
    from lowsnr_detect.calibration.operating_point import calibrated

    shown = 0
    with progress(f'calibrating {name}', 100, '%', delay_s=0.5, leave=False) as advance:
        def show(done: float) -> None:
            nonlocal shown
            advance(round(100 * done) - shown)
            shown = round(100 * done)

        return calibrated(detector, prob, shape, progress=show, warn=say)


def write_parameters(plan: 'RunPlan', folder: Path) -> None:
    """Write the parameter file that every node of the run reads."""
    from lowsnr_bringup.plan.graph import to_yaml
    from lowsnr_bringup.run.results_folder import PARAMETERS_FILE

    file = (folder / PARAMETERS_FILE).resolve()
    plan.parameters['/evaluator']['results'] = str(folder.resolve())
    if '/recorder' in plan.parameters:
        plan.parameters['/recorder']['run_parameters'] = str(file)
    file.write_text(to_yaml(plan.parameters), encoding='utf-8')


def run(plan: 'RunPlan', folder: Path, server: 'NodeServer') -> int:
    """Start the graph, wait for its end, and present what it scored; return the exit code."""
    from lowsnr_bringup.ros.domain_guard import DomainTaken
    from lowsnr_bringup.ros.supervisor import Supervisor

    patience_s = plan.parameters['/evaluator']['answer_within_s'] + 2.0
    supervisor = Supervisor(
        plan.nodes, folder, plan.frames, patience_s, plan.respawn, server=server)
    try:
        status, trouble = supervisor.run()
    except DomainTaken as error:
        shutil.rmtree(folder)  # it holds nothing but what this run made
        say(str(error))
        return USAGE
    present(plan, folder, supervisor.account, trouble)
    return status


def present(plan: 'RunPlan', folder: Path, account: 'Account', trouble: str) -> None:
    """Sum up the scores, print them, and write the report."""
    from lowsnr_bringup.run.results_folder import SUMMARY_FILE
    from lowsnr_common.settings.text import one_line
    from lowsnr_eval.report.table import format_table
    from lowsnr_eval.scoring.final_summary import summarize_run

    try:
        summarize_run(folder, plan.parameters['/evaluator'], account)
    except (OSError, ValueError) as error:
        say(f'no summary: {one_line(error)}')
    summary = folder / SUMMARY_FILE
    if summary.is_file():
        print(format_table(json.loads(summary.read_text(encoding='utf-8'))))
    if trouble:
        say(trouble)
    print(f'results in {folder}')
    if '/recorder' in plan.parameters:
        from lowsnr_bringup.bags.recording import bags_of_run
        from lowsnr_bringup.bags.recording import summarize_recording
        for bag in bags_of_run(Path(plan.parameters['/recorder']['bag'])):
            print(summarize_recording(bag))
    if summary.is_file():
        report(folder)


def report(folder: Path) -> None:
    """Write the page that shows the run; scores do not depend on it."""
    from lowsnr_common.settings.text import one_line
    from lowsnr_eval.report.run_report import write_run_report

    command = shlex.join(['python', 'scripts/bringup.py', *sys.argv[1:]])
    try:
        print(f'report: {write_run_report(folder, command)}')
    except (OSError, ValueError) as error:
        say(f'no report: {one_line(error)}')


def say(text: str) -> None:
    """Print one line for the user, apart from the table of scores."""
    from lowsnr_common.settings.text import printable_lines

    print(f'bringup.py: {printable_lines(text)}', file=sys.stderr)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
