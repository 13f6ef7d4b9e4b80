"""Run the whole graph: sensor, detectors, trackers and evaluator, to a table of scores."""

import argparse
import json
import os
from pathlib import Path
import shlex
import sys
from typing import TYPE_CHECKING

from _arguments import INTERRUPTED
from _arguments import number
from _arguments import Parser
from _arguments import USAGE
import _environment

if TYPE_CHECKING:
    from lowsnr_bringup.bags.recorded_run import RecordedRun
    from lowsnr_bringup.plan.run_plan import RunPlan

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / 'config'


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='bringup.py', description=__doc__, allow_abbrev=False,
        epilog='example: python scripts/bringup.py --detector cdt sdt --scenario example3 '
        '--snr 9 --lockstep --set sdt.max_iterations=8; exit code: 0 done, 1 failed, 2 usage or '
        'configuration error, 130 after Ctrl-C')
    add_what_to_run(parser)
    add_what_to_replay(parser)
    add_how_to_run(parser)
    add_who_takes_part(parser)
    return parser.parse_args(arguments)


def add_what_to_run(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is simulated and detected."""
    parser.add_argument(
        '--detector', nargs='+', default=['sdt'], metavar='NAME',
        help='detectors to run side by side on the same frames (default: sdt)')
    frames = parser.add_mutually_exclusive_group()
    frames.add_argument(
        '--scenario', default='example4', metavar='NAME|FILE',
        help='a file of config/scenarios without .yaml, or a path (default: example4)')
    frames.add_argument(
        '--replay', type=Path, metavar='BAG',
        help='take the frames and the truth of a bag, not those of a scenario')
    frames.add_argument(
        '--camera', metavar='TOPIC',
        help='take the frames of a live camera, such as /camera/image_raw, until Ctrl-C')
    parser.add_argument(
        '--snr', type=number(-30.0), metavar='DB',
        help="SNR of the object, and that detectors expect [dB] (default: the scenario's)")
    parser.add_argument(
        '--frames', type=number(1, whole=True), metavar='N',
        help='number of frames (default: all of the scenario)')
    parser.add_argument(
        '--seed', type=number(0, whole=True), metavar='N', help='root seed (default: 0)')
    parser.add_argument(
        '--set', action='append', default=[], metavar='NODE.PARAMETER=VALUE', dest='overrides',
        help='set one parameter of sensor, tracker, evaluator or a detector; may be repeated')


def add_what_to_replay(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what of a bag or camera is used."""
    parser.add_argument(
        '--frames-topic', metavar='TOPIC',
        help="topic of the frames in the bag (default: its run's, or /image_raw)")
    parser.add_argument(
        '--truth-topic', default='/ground_truth', metavar='TOPIC',
        help='topic of the truth in the bag, if it has any (default: /ground_truth)')
    parser.add_argument(
        '--condition', choices=('auto', 'on', 'off'), default='auto',
        help='whether background and uneven noise are taken off the frames of a bag or camera '
        '(default: auto, unless a simulation was recorded)')
    parser.add_argument(
        '--camera-within', type=number(0.0, above=True), default=10.0, metavar='S',
        help='longest wait for the first frames of a camera [s] (default: 10)')


def add_how_to_run(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how fast, how long, and what is kept."""
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        '--rate', type=number(0.0, above=True), metavar='HZ',
        help='frames a second of wall time (default: 10, or as a bag was recorded)')
    pace.add_argument(
        '--lockstep', action='store_true',
        help='as fast as the graph answers; the same results every time')
    parser.add_argument('--loop', action='store_true', help='repeat the scenario until Ctrl-C')
    parser.add_argument(
        '--respawn', action=argparse.BooleanOptionalAction,
        help='start a node again that died; where it dies again and again the run ends (default: '
        'with --loop and --camera)')
    parser.add_argument(
        '--record', type=Path, metavar='DIR', help='record every topic into a new rosbag2 bag')
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap',
        help='how the bag is stored (default: mcap)')
    parser.add_argument(
        '--view', action='store_true',
        help='publish overlay and markers for RViz and Foxglove, see config/lowsnr.rviz')
    parser.add_argument(
        '--results', type=Path, metavar='DIR',
        help='folder for results (default: results/SCENARIO-DETECTORS, or that with a number)')


def add_who_takes_part(parser: argparse.ArgumentParser) -> None:
    """Add the options that say who hears the nodes."""
    parser.add_argument(
        '--domain-id', type=number(0, whole=True), metavar='N',
        help='ROS domain (default: ROS_DOMAIN_ID, or 0)')
    parser.add_argument(
        '--secure', type=Path, metavar='KEYSTORE',
        help='start every node in its enclave of this SROS 2 keystore, with security enforced; '
        'what the keystore lacks is said, with the commands that make it')


def main() -> int:
    """Run; return the exit code."""
    _environment.ensure()
    options = parse_arguments(sys.argv[1:])
    if not os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE'):  # ROS takes empty for the subnet
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if options.domain_id is not None:
        os.environ['ROS_DOMAIN_ID'] = str(options.domain_id)
    from lowsnr_bringup.plan.graph import to_yaml
    from lowsnr_bringup.run.domain import claim_domain
    from lowsnr_bringup.run.middleware import middleware_environment
    from lowsnr_bringup.run.results_folder import fresh_folder
    from lowsnr_bringup.run.results_folder import PARAMETERS_FILE
    import rclpy
    try:
        plan = plan_of(options)
        claim = claim_domain()
        if options.secure is not None:
            secure(options.secure, [node.path for node in plan.nodes])
        folder = fresh_folder(options.results or ROOT / 'results' / plan.name)
        os.environ |= middleware_environment(
            os.environ, folder, rclpy.get_rmw_implementation_identifier())
    except ValueError as error:
        print(f'bringup.py: {error}', file=sys.stderr)
        return USAGE
    with claim:
        for note in plan.notes:
            print(f'bringup.py: {note}', file=sys.stderr)
        calibrate(plan)
        plan.parameters['/evaluator']['results'] = str(folder.resolve())
        file = (folder / PARAMETERS_FILE).resolve()
        if '/recorder' in plan.parameters:
            plan.parameters['/recorder']['run_parameters'] = str(file)
        file.write_text(to_yaml(plan.parameters), encoding='utf-8')
        return run(plan, folder)


def plan_of(options: argparse.Namespace) -> 'RunPlan':
    """Return the checked plan of the run that the options ask for."""
    from lowsnr_bringup.plan.run_options import RunOptions
    from lowsnr_bringup.plan.run_plan import plan_run

    def look(topic: str) -> 'RecordedRun':
        from lowsnr_bringup.ros.camera import look_at_camera
        if options.secure is not None:
            secure(options.secure, [])
        return look_at_camera(topic, options.camera_within)

    return plan_run(RunOptions(
        detectors=options.detector, scenario=options.scenario, snr_db=options.snr,
        frames=options.frames, seed=options.seed, rate_hz=options.rate,
        lockstep=options.lockstep, loop=options.loop, overrides=options.overrides,
        record=options.record, storage=options.storage, replay=options.replay,
        frames_topic=options.frames_topic, truth_topic=options.truth_topic,
        condition=options.condition, view=options.view, respawn=options.respawn,
        camera=options.camera), CONFIG, look)


def secure(keystore: Path, nodes: list[str]) -> None:
    """Have all that is started from here on enforce security, each node in its own enclave."""
    from lowsnr_bringup.plan.graph import MANAGER
    from lowsnr_bringup.run.security import secured_environment

    os.environ |= secured_environment(keystore, [f'/{MANAGER}', *nodes], os.environ)


def calibrate(plan: 'RunPlan') -> None:
    """Find the thresholds of matched detectors here, where progress can be shown."""
    from lowsnr_detect.calibration.operating_point import calibrated
    from tqdm import tqdm

    for path, detector in plan.detectors.items():
        values = plan.parameters[path]
        if values['operating_point'] != 'matched':
            continue
        with tqdm(total=100, desc=f'calibrating {path}', unit='%', leave=False,
                  disable=None, delay=0.5) as bar:
            def show(done: float, bar: tqdm = bar) -> None:
                bar.update(round(100 * done) - bar.n)
            calibrated(
                detector, values['false_alarm_prob'], (values['rows'], values['cols']),
                progress=show)


def run(plan: 'RunPlan', folder: Path) -> int:
    """Start the graph, wait for its end, and print what it scored."""
    from lowsnr_bringup.bags.recording import bags_of_run
    from lowsnr_bringup.bags.recording import summarize_recording
    from lowsnr_bringup.ros.supervisor import Supervisor
    from lowsnr_eval.report.table import format_table
    from lowsnr_eval.scoring.final_summary import summarize_run

    patience_s = plan.parameters['/evaluator']['answer_within_s'] + 2.0
    supervisor = Supervisor(plan.nodes, folder, plan.frames, patience_s, plan.respawn)
    status, trouble = supervisor.run()
    try:
        summarize_run(folder, plan.parameters['/evaluator'], supervisor.account)
    except (OSError, ValueError) as error:
        print(f'bringup.py: no summary: {" ".join(str(error).split())}', file=sys.stderr)
    summary = folder / 'summary.json'
    if summary.is_file():
        print(format_table(json.loads(summary.read_text(encoding='utf-8'))))
    if trouble:
        print(f'bringup.py: {trouble}', file=sys.stderr)
    print(f'results in {folder}')
    if '/recorder' in plan.parameters:
        for bag in bags_of_run(Path(plan.parameters['/recorder']['bag'])):
            print(summarize_recording(bag))
    if summary.is_file():
        report(folder)
    return status


def report(folder: Path) -> None:
    """Write the page that shows the run; scores do not depend on it."""
    from lowsnr_eval.report.run_report import write_run_report

    command = shlex.join(['python', 'scripts/bringup.py', *sys.argv[1:]])
    try:
        print(f'report: {write_run_report(folder, command)}')
    except (OSError, ValueError) as error:
        print(f'bringup.py: no report: {" ".join(str(error).split())}', file=sys.stderr)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
