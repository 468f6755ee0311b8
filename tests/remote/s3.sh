#!/usr/bin/env bash
# Runs the tests of shared caches against a real S3 server on this machine: `tests/remote/s3.sh [moto|s3s-fs]`.
#
#   moto     pip install 'moto[server]'
#   s3s-fs   cargo install s3s-fs --version 0.14.1 --features binary
#
# Without a name, the one that is installed; without any, it says so and ends with 0.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

server=${1:-}
if [ -z "$server" ]; then
    if command -v s3s-fs >/dev/null; then server=s3s-fs
    elif command -v moto_server >/dev/null && moto_server --help >/dev/null 2>&1; then server=moto
    else
        echo "SKIPPED: no S3 server here; install moto (pip install 'moto[server]') or s3s-fs (cargo install s3s-fs)"
        exit 0
    fi
fi

port=${PORT:-15557}
folder=$(mktemp -d)
export AWS_ACCESS_KEY_ID=test AWS_SECRET_ACCESS_KEY=testtest AWS_DEFAULT_REGION=us-east-1
case $server in
    moto) moto_server -H 127.0.0.1 -p "$port" >"$folder/log" 2>&1 & ;;
    s3s-fs)
        mkdir -p "$folder/root"
        s3s-fs --host 127.0.0.1 --port "$port" --access-key test --secret-key testtest "$folder/root" >"$folder/log" 2>&1 &
        ;;
    *) echo "expected moto or s3s-fs, got $server" >&2; exit 2 ;;
esac
pid=$!
trap 'kill "$pid" 2>/dev/null; rm -rf "$folder"' EXIT

for _ in $(seq 100); do
    (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null && break
    kill -0 "$pid" 2>/dev/null || { cat "$folder/log" >&2; exit 1; }
    sleep 0.1
done

if [ "$server" = s3s-fs ]; then
    mkdir "$folder/root/bucket"
else
    # moto takes unsigned requests.
    curl --silent --fail --request PUT "http://127.0.0.1:$port/bucket" >/dev/null
fi

echo "$server on port $port"
export DRIL_TEST_S3="http://127.0.0.1:$port"
features="--package dril-pipe --no-default-features --features remote"
# The program under test is an example, which `cargo test --test` alone does not build.
cargo build $features --example fakes
cargo test $features --test it -- remote:: s3_server --nocapture
