# SPDX-License-Identifier: Apache-2.0
# lowsnr on an installed ROS 2 Jazzy:
#   docker build --tag lowsnr . && docker run --rm lowsnr bringup --detector sdt
FROM ros:jazzy-ros-base
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /opt/lowsnr
COPY . .

# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-venv \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --rosdistro jazzy --default-yes \
        --dependency-types exec \
    && rm -rf /var/lib/apt/lists/*

# .venv gets what rosdistro does not have; colcon's executables start with its Python.
# hadolint ignore=SC1091
RUN source /opt/ros/jazzy/setup.bash \
    && PYTHONPATH="scripts:$PYTHONPATH" python3 -c 'import _environment; _environment.ensure()' \
    && source .venv/bin/activate \
    && python -m colcon build --install-base /opt/install \
    && rm -rf build log \
    && useradd --create-home --uid 10001 lowsnr

USER 10001
WORKDIR /home/lowsnr
ENTRYPOINT ["/bin/bash", "-c", "source /opt/install/setup.bash && exec ros2 run lowsnr_bringup \"$@\"", "lowsnr"]
CMD ["bringup", "--detector", "sdt"]
