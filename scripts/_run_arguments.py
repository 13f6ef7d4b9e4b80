# SPDX-License-Identifier: Apache-2.0
"""The command line of ``bringup.py``."""

import argparse
from collections.abc import Iterable
from pathlib import Path
import re
from typing import Any

from _arguments import CONFIG
from _arguments import detector_name
from _arguments import detectors
from _arguments import input_path
from _arguments import number
from _arguments import override
from _arguments import Parser
from _arguments import scenario_name
from _arguments import scenarios
from _arguments import SNR_DB
from _arguments import tiles
from _film_arguments import add_film
from _film_arguments import add_truth
import _parameters


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options, named as in RunOptions; ``--help`` and errors end here."""
    parser = Parser(
        prog='bringup.py',
        description='Run the whole graph: sensor, detectors, trackers and evaluator, to a table '
        'of scores.',
        epilog='example: python scripts/bringup.py --detector cdt sdt --scenario example3 '
        '--snr 9 --lockstep --set sdt.max_iterations=8; exit code: 0 done, 1 failed, 2 usage or '
        'configuration error, 130 after Ctrl-C')
    add_frames(parser)
    add_recorded_frames(parser)
    add_processing(parser)
    add_outputs(parser)
    add_network(parser)
    add_hosts(parser)
    parser.add_argument(
        '--list', choices=('detectors', 'scenarios', 'parameters'),
        help='print all names that --detector or --scenario take, or the parameters that --set '
        'takes of the detectors of the run and of the other nodes, and end')
    options = parser.parse_args(arguments)
    if options.list in ('detectors', 'scenarios'):
        print_names(detectors() if options.list == 'detectors' else scenarios())
        parser.exit()
    if options.list and (known := _parameters.listed(CONFIG, options.detectors)) is not None:
        print_parameters(known)
        parser.exit()
    return options


def print_names(described: dict[str, str]) -> None:
    """Print names and what each is, one a line."""
    width = max(map(len, described))
    for name, text in described.items():
        print(f'{name:<{width}}  {text}')


def extras_of(options: argparse.Namespace) -> tuple[str, ...]:
    """Return which extras of the environment the run needs."""
    if options.replay:
        return ('bags', 'files')
    return ('bags',) * bool(options.record) + ('images',) * bool(options.camera or options.view)


def modules_of(options: argparse.Namespace) -> list[tuple[str, ...]]:
    """Return modules that one node of this host needs each, with what their ``preload`` takes."""
    real = options.camera or options.replay
    conditioner = real and _runs_here('conditioner', options)
    return [('lowsnr_sensor.conditioner_node',)] * bool(conditioner) + [
        ('lowsnr_detect.node.warm_up', name, 'adaptive' if real else 'matched')
        for name in options.detectors if _runs_here(name, options)]


def _runs_here(name: str, options: argparse.Namespace) -> bool:
    """Return whether the conditioner or a detector, or a tile of it, may run on this host."""
    def names(words: Iterable[str]) -> set[str]:
        return {word.rpartition('.')[2].removesuffix('_detector') for word in words}
    if options.only:
        return name in {re.sub(r'_\d+$', '', word) for word in names(options.only)}
    # Of a detector in tiles the node of its name is the merger.
    return options.tiles != (1, 1) or name not in names(options.expect)


def print_parameters(described: Iterable[tuple[str, Any, str, str]]) -> None:
    """Print parameters that ``--set`` takes, with value, meaning and allowed values."""
    for name, value, allowed, text in described:
        print(f'{name} = {value}\n    {text}; {allowed}')


def add_frames(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which frames the run has."""
    frames = parser.add_mutually_exclusive_group()
    frames.add_argument(
        '--scenario', type=scenario_name, default='example4', metavar='NAME|FILE',
        help='simulate a scenario: a file of config/scenarios without .yaml, or a path '
        '(default: example4)')
    frames.add_argument(
        '--replay', type=input_path, metavar='BAG|FILE',
        help='take the frames and the truth from a bag, or from files as convert.py does')
    frames.add_argument(
        '--camera', metavar='TOPIC',
        help='take the frames from a live camera, such as /camera/image_raw, until Ctrl-C')
    parser.add_argument(
        '--snr', type=number(*SNR_DB), metavar='DB', dest='snr_db',
        help='SNR that the object has and that detectors expect [dB] (default: that of the '
        'scenario)')
    parser.add_argument(
        '--frames', type=number(1, whole=True), metavar='N',
        help='number of frames (default: all of the scenario or bag)')
    parser.add_argument(
        '--seed', type=number(0, whole=True), metavar='N',
        help='root seed of all random numbers (default: 0, or that of the recorded run)')
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        '--rate', type=number(0.0, above=True), metavar='HZ', dest='rate_hz',
        help='frames a second of wall time (default: 10, or as recorded in the bag)')
    pace.add_argument(
        '--lockstep', action='store_true',
        help='publish a frame once the one before is scored: as fast as the graph can, with the '
        'same results every time')
    parser.add_argument('--loop', action='store_true', help='repeat the scenario until Ctrl-C')


def add_recorded_frames(parser: Parser) -> None:
    """Add the options about the frames of a bag or camera."""
    parser.add_argument(
        '--frames-topic', metavar='TOPIC',
        help='topic of the frames in the bag (default: that of the recorded run, or /image_raw)')
    parser.add_argument(
        '--truth-topic', default='/ground_truth', metavar='TOPIC',
        help='topic of the truth in the bag, if it has any (default: /ground_truth)')
    add_film(parser)
    add_truth(parser)
    parser.only_with('--replay', '--select', '--pattern', '--period', '--truth')
    parser.only_with('--replay', '--frames-topic', '--truth-topic', unless='--camera')
    parser.set_defaults(truth_bag=None)  # what becomes of --truth
    parser.add_argument(
        '--condition', choices=('auto', 'on', 'off'), default='auto',
        help='whether a conditioner subtracts the background and evens out the noise of the '
        'frames of a bag or camera (default: auto: on, unless the bag is of a simulation)')
    parser.add_argument(
        '--camera-within', type=number(0.0, above=True), default=10.0, metavar='S',
        help='longest wait for the first frames of the camera [s] (default: 10)')
    parser.only_with('--camera', '--camera-within')


def add_processing(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which nodes process the frames, and with which parameters."""
    parser.add_argument(
        '--detector', nargs='+', type=detector_name, default=['sdt'], metavar='NAME',
        dest='detectors',
        help='detectors to run side by side on the same frames (default: sdt)')
    parser.add_argument(
        '--set', action='append', type=override, default=[], metavar='NODE.PARAMETER=VALUE',
        dest='overrides',
        help='set one parameter of a detector, tracker or any other node, or of all nodes that '
        'have it, as in all.sensor.noise.model=student_t; may be repeated')
    parser.add_argument(
        '--respawn', action=argparse.BooleanOptionalAction,
        help='restart a node that dies; if it dies again and again, the run ends (default: '
        'only with --loop and --camera)')
    parser.add_argument(
        '--composed', action='store_true',
        help='run conditioner, detectors and trackers in one process, which hands frames over '
        'without copies: the same results with less delay, on one core')
    parser.add_argument(
        '--tiles', type=tiles, default=(1, 1), metavar='NxM',
        help='divide each detector between nodes for N x M tiles of the frame, N down and M '
        'across, such as sdt_1 and sdt_2, which may run on several hosts: cdt, sdt, cusum, bank '
        'and auto, with thresholds that are not adaptive (default: 1x1, one node)')


def add_outputs(parser: Parser) -> None:
    """Add the options that say what the run leaves and shows."""
    parser.add_argument(
        '--results', type=Path, metavar='DIR',
        help='folder for the results (default: results/SCENARIO-DETECTORS, with a number '
        'appended if it is taken)')
    parser.add_argument(
        '--record', type=Path, metavar='DIR', help='record every topic in a new rosbag2 bag')
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap',
        help='storage format of the bag (default: mcap)')
    parser.add_argument(
        '--view', action='store_true',
        help='show the run live: a page in the browser, and overlay and markers for RViz and '
        'Foxglove, see config/lowsnr.rviz')
    parser.add_argument(
        '--statistic', action='store_true', dest='statistic_map',
        help='publish the test statistic of every cell on the topic statistic, for report, live '
        'page and bag')
    parser.add_argument(
        '--view-port', type=number(1, 65535, whole=True), default=0, metavar='PORT',
        help='port of the live page on this host, the next ones for further detectors (default: '
        'the first free one from 8470 on)')
    parser.add_argument(
        '--no-browser', action='store_false', dest='browser',
        help='print the address of the live page and open it nowhere')
    parser.only_with('--record', '--storage')
    parser.only_with('--view', '--view-port', '--no-browser')


def add_network(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which other processes can communicate with the nodes."""
    parser.add_argument(
        '--domain-id', type=number(0, whole=True), metavar='N',
        help='ROS domain (default: ROS_DOMAIN_ID, or 0)')
    parser.add_argument(
        '--secure', type=Path, metavar='KEYSTORE',
        help='start every node in its enclave of this SROS 2 keystore, with security enforced; '
        'if the keystore lacks something, the error shows the commands that create it')


def add_hosts(parser: Parser) -> None:
    """Add the options of a run whose nodes are on several hosts."""
    parser.add_argument(
        '--only', nargs='+', default=[], metavar='NODE',
        help='run only these nodes here, such as evaluator, tracker, sdt_detector, or cdt.tracker '
        'of several chains; --expect names the others')
    parser.add_argument(
        '--expect', nargs='+', default=[], metavar='NODE',
        help='nodes of the run that the same command runs on other hosts, with another --only and '
        '--expect and otherwise the same options; without --only all others run here')
    parser.add_argument(
        '--expect-within', type=number(0.0, above=True), default=600.0, metavar='S',
        help='longest wait for the other hosts of the run [s] (default: 600)')
    parser.only_with('--expect', '--expect-within')
    parser.add_argument(
        '--peers', nargs='+', default=[], metavar='HOST',
        help='open discovery to these hosts, or to all of the local network with the word subnet: '
        'everybody there who reaches this host can then send to the run; see --secure (default: '
        'no other host, unless the environment opens it)')
