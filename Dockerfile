# docker build -t wayside . && docker run --rm -v "$PWD:/data" wayside run drive.mcap -o out
FROM python:3.11-slim
WORKDIR /data
COPY . /src
# The run compiles every kernel once, so that no container waits for it.
RUN pip install --no-cache-dir -c /src/requirements.lock "/src[video,gis,query,fleet]" \
 && wayside run /src/recordings/demo.mcap -o /tmp/demo && rm -r /src /tmp/demo
ENTRYPOINT ["wayside"]
