# Runs the two commands of the README while it builds: the main job, then the tests. The image then runs the command line:
#
#   docker build -t slam-init .
#   docker run --rm -v "$PWD:/data" slam-init run /data/video.mp4 --camera /data/camera.yaml --out /data/out
FROM python:3.12-slim AS tested
ENV PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /src
COPY . .
RUN python -m pip install . && slam-init run --out first
RUN python -m pip install ".[test]" && python -m pytest && touch /tested

FROM python:3.12-slim
ENV PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore
COPY --from=tested /src /src
# The stage is built only if the tests passed.
COPY --from=tested /tested /
RUN python -m pip install /src && rm -r /src && useradd --create-home user
USER user
WORKDIR /home/user
# What numba compiles at the first run is kept in the image, below the home of the user, for any processor.
RUN NUMBA_CPU_NAME=generic slam-init run --quiet --out first && rm -r first
ENTRYPOINT ["slam-init"]
CMD ["--help"]
