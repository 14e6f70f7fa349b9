# docker build -t cornercase .
# docker run --rm -v "$PWD:/work" cornercase demo x-intersection -o demo

# The full image has a C compiler, for processors for which a package comes as source; it does not get into the result.
FROM python:3.12-bookworm AS build
COPY . /source
ARG EXTRAS=cluster,live,parquet,stl,sumo
RUN python -m venv /opt/cornercase && /opt/cornercase/bin/pip install --no-cache-dir "/source[$EXTRAS]"

FROM python:3.12-slim-bookworm
COPY --from=build /opt/cornercase /opt/cornercase
# Compiled for any processor of this family. Whoever runs the image may write there: numba takes no other folder.
ENV PATH=/opt/cornercase/bin:$PATH NUMBA_CACHE_DIR=/opt/numba NUMBA_CPU_NAME=generic
RUN cornercase warm-up && chmod -R a+rwX /opt/numba
RUN useradd --create-home --uid 1000 tester
USER tester
WORKDIR /work
ENTRYPOINT ["cornercase"]
CMD ["--help"]
