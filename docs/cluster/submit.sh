#!/bin/bash
# Submit the shards of a campaign, and the merge that waits for them: submit.sh CAMPAIGN.toml DIR
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
shards=$(sbatch --parsable "$here/campaign.sbatch" "$1" "$2")
sbatch --parsable --dependency="afterok:$shards" --job-name=merge --mem=2G --time=01:00:00 \
    --wrap="uqharness campaign merge '$2' && uqharness campaign report '$2'"
