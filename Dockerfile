# syntax=docker/dockerfile:1
# For CPUs and, with --target cuda, for NVIDIA GPUs; docs/installation.md has the commands.
FROM python:3.11-slim AS wheel
COPY . /source
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /source

FROM python:3.11-slim AS base
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --no-install-recommends --yes libegl1 libopengl0 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
COPY requirements.lock /
ENV HTCP_CACHE=/tmp/htcp-cache
RUN useradd --create-home --uid 1000 htcp && install --directory --owner htcp /work
WORKDIR /work
ENTRYPOINT ["htcp"]
CMD ["--help"]

# The wheels of jax[cuda12] bring CUDA; the host needs the driver alone.
FROM base AS cuda
RUN --mount=from=wheel,source=/wheels,target=/wheels \
    pip install --no-cache-dir --constraint /requirements.lock "$(echo /wheels/*.whl)[cuda,movie]"
USER 1000

FROM base AS cpu
RUN --mount=from=wheel,source=/wheels,target=/wheels \
    pip install --no-cache-dir --constraint /requirements.lock "$(echo /wheels/*.whl)[movie]"
USER 1000
