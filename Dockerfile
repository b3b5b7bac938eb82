# One image for the three roles; docker-compose.yml says which container plays which.
# Run alone, it is the service with its own two worker processes, and needs `-e BOUNCE_TOKEN=...`.
FROM python:3.11-slim-bookworm

LABEL org.opencontainers.image.title="bouncing-spring" \
    org.opencontainers.image.description="Parameter studies of the bouncing spring: service, scheduler and workers" \
    org.opencontainers.image.version="0.3.0" \
    org.opencontainers.image.licenses="MIT"

ENV PIP_NO_CACHE_DIR=1 \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PYTHONUNBUFFERED=1 \
    MPLCONFIGDIR=/tmp/matplotlib \
    NUMBA_CACHE_DIR=/app/numba-cache \
    BOUNCE_DATA=/data

RUN useradd --uid 10001 --no-create-home --home-dir /app --shell /usr/sbin/nologin bounce \
    && install --directory --owner=bounce --group=bounce /app /data

WORKDIR /app

# The libraries change seldom and the code often: their layer comes first.
COPY requirements.lock ./
RUN pip install --require-hashes -r requirements.lock

COPY pyproject.toml README.md LICENSE ./
COPY kernel ./kernel
COPY worker ./worker
COPY service ./service
COPY bouncing_spring ./bouncing_spring
RUN pip install --no-deps --no-build-isolation --no-compile . \
    && rm -rf build ./*.egg-info bouncing_spring kernel worker service \
    && site="$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')" \
    && python -m compileall -q "$site/kernel" "$site/worker" "$site/service"

USER 10001

# Compiled once here instead of by the first jobs. On another processor what was compiled before optimisation
# is optimised and emitted anew, in a third of the time.
RUN python -m worker.kernel_cache

# The root file system may be read-only (docker run --read-only --tmpfs /tmp): what is written lies in these
# volumes and /tmp. A new volume of the cache begins with what was compiled above.
VOLUME ["/data", "/app/numba-cache"]
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=10s --start-period=300s --retries=3 \
    CMD ["python", "-c", "from urllib.request import urlopen; urlopen('http://127.0.0.1:8000/healthz', timeout=4)"]
CMD ["bounce", "serve", "--host", "0.0.0.0", "--port", "8000", "--data", "/data"]
