# SPDX-License-Identifier: Apache-2.0
"""What another program on the same host receives from a run."""

from lowsnr_common.ros.messages import stamp_key

FRAMES = 40
SECOND = 1_000_000_000


def stamps(messages):
    """Return the stamps of messages with a header."""
    return [stamp_key(message.header.stamp) for message in messages]


def test_every_frame_is_answered_once_with_its_own_header(published):
    received = published('three_objects')
    wanted = [k * SECOND for k in range(1, FRAMES + 1)]
    for topic in ('image_raw', 'ground_truth', 'detections', 'tracks'):
        assert stamps(received[topic]) == wanted, topic
        assert {message.header.frame_id for message in received[topic]} == {'sensor'}
    assert [stamp_key(message.clock) for message in received['clock']] == wanted
    # An entry with an id has one odometry of that id and stamp, and there are no others.
    for topic in ('ground_truth', 'tracks'):
        named = [(stamp, entry.id) for stamp, message in zip(wanted, received[topic])
                 for entry in message.detections]
        states = received[f'{topic}/odometry']
        assert sorted(zip(stamps(states), (m.child_frame_id for m in states))) == sorted(named)
        assert len(named) > FRAMES
    image = received['image_raw'][0]
    assert (image.encoding, image.height, image.width, image.step) == ('32FC1', 20, 20, 80)
