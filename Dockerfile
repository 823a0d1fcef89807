# docker build --target serve --tag airgs-serve .    airgs-serve and what it takes
# docker build --target farm --tag airgs-farm .      all commands but training, and Dask
FROM python:3.11-slim AS source
WORKDIR /source
COPY LICENSE README.md constraints.txt pyproject.toml ./
COPY airgs_codec airgs_codec/

FROM source AS serve
RUN pip install --no-cache-dir -c constraints.txt cyclopts hypercorn numpy starlette \
    && pip install --no-cache-dir --no-deps .
USER nobody
WORKDIR /packages
EXPOSE 8000
ENTRYPOINT ["airgs-serve", "--host", "0.0.0.0"]
CMD ["/packages"]

# libgomp1 has the threads of numba's fastest pool; numba and matplotlib store what they make at home.
FROM source AS farm
RUN apt-get update && apt-get install --yes --no-install-recommends libgomp1 && rm -r /var/lib/apt/lists/*
RUN pip install --no-cache-dir -c constraints.txt '.[farm,formats]'
ENV HOME=/tmp
USER nobody
WORKDIR /work
CMD ["dask", "scheduler"]
