#!/bin/bash
# @COMMENT@
# Submit from the folder of the inputs with `bash THIS_FILE`. `sage status @OUT@` says what is done.
#SBATCH --job-name=@NAME@
#SBATCH --cpus-per-task=@CORES@
#SBATCH --mem=@MEMORY@G
#SBATCH --time=@MINUTES@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=@NAME@-%A_%a.log
set -u
shards=@SHARDS@

if [ -z "${SAGE_FIRST:-}" ]; then
  case $0 in */slurm_script) echo "submit this script with bash, not with sbatch" >&2 && exit 2 ;; esac
  # Where jobs are submitted: arrays as long as the site allows, one after another, then the join.
  most=$(scontrol show config | sed -n 's/^MaxArraySize *= *\([0-9]*\).*/\1/p')
  most=$((${most:-1001} - 1))
  after=
  for ((first = 0; first < shards; first += most)); do
    count=$((shards - first < most ? shards - first : most))
    job=$(sbatch --parsable ${after:+"--dependency=afterany:$after"} --export="ALL,SAGE_FIRST=$first" \
      --array="1-$count%@AT_ONCE@" "$0") || {
      echo "shards $((first + 1)) to $shards are not submitted; run this script again when the others have ended" >&2
      exit 1
    }
    after=${job%%;*}
    echo "job $after: shards $((first + 1)) to $((first + count))"
  done
  echo "after them, the join:"
  exec sbatch --dependency="afterany:$after" --export=ALL,SAGE_FIRST=join --output=@NAME@-join-%j.log "$0"
fi
if [ "$SAGE_FIRST" = join ]; then
  # A network file system may show the last files late.
  for pause in 30 60 120 0; do
    @JOIN@
    status=$?
    [ "$status" = 74 ] || exit "$status"
    sleep "$pause"
  done
  exit "$status"
fi

@COMMAND@ --threads @CORES@ --shard "$((SAGE_FIRST + SLURM_ARRAY_TASK_ID))/$shards"
status=$?
# 74 is an input or output error: the next try, on any node, goes on where this one stopped.
if [ "$status" = 74 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt @RETRIES@ ]; then
  scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID" && exit 0
fi
exit "$status"
