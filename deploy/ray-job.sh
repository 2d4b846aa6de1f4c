#!/usr/bin/env bash
# A campaign as a Ray job: books, router and run folder on the node the job runs on, workers all over the cluster.
#   deploy/ray-job.sh http://HEAD:8265 night.toml HOST KEYS     (HOST: by which the cluster's nodes reach that node)
# KEYS is the folder of `saflite keys`, made where there is none. The authority's key in it stays here: what is given to
# the job reaches Ray's store, and who reads that could make keys of their own.
set -euo pipefail
[ $# -eq 4 ] || { sed -n '2,3s/^# *//p' "$0" >&2; exit 2; }
head=$1 campaign=$2 host=$3 keys=$4
folder=$(umask 077; mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp "$campaign" "$folder/campaign.toml"
saflite keys init --if-needed --keys "$keys" --host "$host"
saflite keys add ray --if-needed --keys "$keys" --role mutator --role scorer --role worker --role oracle --role recorder
mkdir -p "$folder/keys/peers"
cp "$keys/register.toml" "$folder/keys/"
cp -R "$keys/farm" "$folder/keys/farm"
cp -R "$keys/peers/ray" "$folder/keys/peers/ray"
# shellcheck disable=SC2016  # the node's home and time, where its shell runs this
ray job submit --address "$head" --working-dir "$folder" -- \
    saflite run campaign.toml --on ray:auto --listen tls/0.0.0.0:7447 --keys keys --out '$HOME/saflite/run-$(date +%s)' --json
