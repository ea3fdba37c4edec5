#!/bin/bash
# Runs the shards of a command as arrays of Slurm, and joins them at the end. Change the limits below, and submit from the folder
# of the inputs with bash, not with sbatch:
#   bash slurm.sh 200 sage generate scenes/ --format rows --no-pages --quiet --out attacked/
# `sage status attacked/` says what is done. The same line again finishes what is missing.
#SBATCH --cpus-per-task=4
#SBATCH --mem=4G
#SBATCH --time=60
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%A_%a.log
at_once=50 # most shards that run at the same time
retries=3  # how often a shard is tried again; Slurm counts what it requeues for other reasons too
set -u

shards=${1:-}
command=("${@:2}")
out=
for ((k = 0; k < ${#command[@]}; k++)); do
  case ${command[k]} in
    --out) out=${command[k + 1]:-} ;;
    --out=*) out=${command[k]#--out=} ;;
    --shard* | --threads* | --force) shards= ;; # the script gives the first two, and a shard cannot begin anew for the others
  esac
done
case $0 in */slurm_script) [ -n "${SAGE_FIRST:-}" ] || shards= ;; esac
if ! [[ $shards =~ ^[1-9][0-9]*$ && -n $out ]]; then
  echo "usage: bash slurm.sh SHARDS sage COMMAND ... --out DIR    without --shard, --threads and --force" >&2
  exit 2
fi

if [ -z "${SAGE_FIRST:-}" ]; then
  # Where jobs are submitted: arrays as long as the site allows, one after another, then the join.
  most=$(scontrol show config | sed -n 's/^MaxArraySize *= *\([0-9]*\).*/\1/p')
  most=$((${most:-1001} - 1))
  name=sage-$(basename -- "$out")
  after=
  for ((first = 0; first < shards; first += most)); do
    count=$((shards - first < most ? shards - first : most))
    job=$(sbatch --parsable --job-name="$name" ${after:+"--dependency=afterany:$after"} \
      --export="ALL,SAGE_FIRST=$first" --array="1-$count%$at_once" "$0" "$@") || {
      echo "shards $((first + 1)) to $shards are not submitted; run this script again when the others have ended" >&2
      exit 1
    }
    after=${job%%;*}
    echo "job $after: shards $((first + 1)) to $((first + count))"
  done
  echo "after them, the join:"
  exec sbatch --job-name="$name-join" --dependency="afterany:$after" --export=ALL,SAGE_FIRST=join --output=%x-%j.log "$0" "$@"
fi
if [ "$SAGE_FIRST" = join ]; then
  # A network file system may show the last files late.
  for pause in 30 60 120 0; do
    "${command[0]}" join "$out" --threads "$SLURM_CPUS_PER_TASK"
    status=$?
    [ "$status" = 74 ] || exit "$status"
    sleep "$pause"
  done
  exit "$status"
fi

"${command[@]}" --threads "$SLURM_CPUS_PER_TASK" --shard "$((SAGE_FIRST + SLURM_ARRAY_TASK_ID))/$shards"
status=$?
# 74 is an input or output error: the next try, on any node, goes on where this one stopped.
if [ "$status" = 74 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt "$retries" ]; then
  scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID" && exit 0
fi
exit "$status"
