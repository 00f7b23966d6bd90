# spinestiff without installing it: many subjects (docs/cohort.md), or the workbench (docs/workbench.md).
#
#   docker build -t spinestiff .
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD/study:/data/study:ro" -v "$PWD/results:/data/results" \
#       spinestiff cohort study results
#
# The workbench for this machine alone listens on its 127.0.0.1, which on Linux needs the host's network:
#
#   docker run --rm -it --network host --user "$(id -u):$(id -g)" -v "$PWD/subjects:/data/subjects" \
#       spinestiff serve subjects --no-browser
#
# For others it stands behind a reverse proxy, which adds the secret to each request (docs/workbench.md):
#
#   docker run --rm -p 127.0.0.1:8080:8080 --user "$(id -u):$(id -g)" -v "$PWD/subjects:/data/subjects" \
#       -v "$PWD/secret.txt:/data/secret.txt:ro" spinestiff serve subjects --no-browser --host 0.0.0.0 --port 8080 \
#       --proxy https://spine.example.org --proxy-secret secret.txt
#
# Build with the extra for JPEG Lossless radiographs: docker build --build-arg EXTRAS="[dicom]" -t spinestiff .

FROM python:3.12-slim-bookworm AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE NOTICE ./
COPY src ./src
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim-bookworm
ARG EXTRAS=""
COPY --from=build /wheels /wheels
RUN python -m pip install --no-cache-dir "$(ls /wheels/*.whl)${EXTRAS}" && rm -r /wheels
# Whoever runs it may have any number and no home: what libraries keep goes where everybody may write. Compiled kernels
# of a cohort are kept in its own folder of results.
ENV HOME=/tmp \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1
USER 65532:65532
WORKDIR /data
RUN spinestiff doctor
ENTRYPOINT ["spinestiff"]
CMD ["--help"]
