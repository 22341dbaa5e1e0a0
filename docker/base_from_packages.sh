#!/bin/sh
# The base of the image from Debian's packages alone, for machines that reach no registry of images:
#   docker/base_from_packages.sh | podman import - localhost/debian:trixie-slim
#   make image BASE=localhost/debian:trixie-slim
# Needs mmdebstrap. What images called slim lack is lacking here, too.
set -eu
for folder in doc info locale man; do
  set -- "$@" --dpkgopt="path-exclude=/usr/share/$folder/*"
done
exec mmdebstrap --variant=minbase "$@" trixie - "${DEBIAN_MIRROR:-http://deb.debian.org/debian}"
