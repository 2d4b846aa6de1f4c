#!/usr/bin/env bash
# A campaign as a Ray job: books, router and run folder on the node the job runs on, workers all over the cluster.
#   deploy/ray-job.sh http://HEAD:8265 night.toml HOST      (HOST: by which the cluster's nodes reach that node)
set -euo pipefail
[ $# -eq 3 ] || { sed -n '2,3s/^# *//p' "$0" >&2; exit 2; }
head=$1 campaign=$2 host=$3
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp "$campaign" "$folder/campaign.toml"
saflite keys init --keys "$folder/keys" --host "$host"
# shellcheck disable=SC2016  # the node's home and time, where its shell runs this
ray job submit --address "$head" --working-dir "$folder" -- \
    saflite run campaign.toml --on ray:auto --listen tls/0.0.0.0:7447 --keys keys --out '$HOME/saflite/run-$(date +%s)' --json
