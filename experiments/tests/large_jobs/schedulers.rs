//! The scripts of `examples/jobs`, run as a cluster runs them.

use std::{
    fs,
    os::unix::{fs::PermissionsExt as _, process::CommandExt as _},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::Mutex,
    time::{Duration, Instant},
};

use sage_core::seed::Rng;
use serde_json::Value;

use super::*;

const SHARDS: u32 = 5;

/// A program that fails with an input or output error at the first try of two shards, and is `sage` otherwise.
const FLAKY: &str = r#"#!/bin/bash
shard=${@: -1}
tried=$TRIED/${shard//\//-}
case $shard in
  2/*|4/*) if [ ! -e "$tried" ]; then touch "$tried"; exit 74; fi ;;
esac
exec SAGE "$@"
"#;

/// What `sbatch` and `scontrol` do here: they write down what they are asked.
const SBATCH: &str = r#"#!/bin/bash
number=$(($(ls "$QUEUE" | grep -c submitted) + 1))
printf '%s\0' "$@" > "$QUEUE/submitted-$number"
echo $number
"#;
const SCONTROL: &str = r#"#!/bin/bash
case $1 in
  show) echo 'MaxArraySize            = 4' ;;
  requeue) touch "$QUEUE/requeue-$2" ;;
esac
"#;

/// A folder with scenes, and programs in place of those of a cluster.
struct Cluster {
    root: tempfile::TempDir,
}

impl Cluster {
    fn new() -> Self {
        let root = tempfile::tempdir().unwrap();
        scenes(root.path(), 9);
        for folder in ["bin", "queue", "tried"] {
            fs::create_dir(root.path().join(folder)).unwrap();
        }
        let flaky = FLAKY.replace("SAGE", env!("CARGO_BIN_EXE_sage"));
        for (name, script) in [("flaky", &*flaky), ("sbatch", SBATCH), ("scontrol", SCONTROL)] {
            let path = root.path().join("bin").join(name);
            fs::write(&path, script).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        }
        Self { root }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    /// A command with the programs of the cluster, in a process group of its own so that all of it can be killed.
    fn command(&self, program: &str) -> Command {
        let path = std::env::var("PATH").unwrap();
        let mut command = Command::new(program);
        command
            .current_dir(self.root.path())
            .env("PATH", format!("{}:{path}", self.at("bin").display()))
            .env("QUEUE", self.at("queue"))
            .env("TRIED", self.at("tried"))
            .env_remove("SAGE_WEIGHTS")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .process_group(0);
        command
    }

    /// One run without shards, and its time.
    fn whole(&self, name: &str, command: &[&str]) -> Duration {
        let clock = Instant::now();
        let out = format!("whole-{name}");
        let output = sage_in(self.root.path(), &[command, &["--out", &out]].concat());
        assert_eq!(output.status.code(), Some(BAD_SCENES), "{name}: {}", stderr(&output));
        clock.elapsed()
    }

    /// Forgets what was tried and submitted.
    fn clear(&self) {
        for folder in ["queue", "tried"] {
            fs::remove_dir_all(self.at(folder)).unwrap();
            fs::create_dir(self.at(folder)).unwrap();
        }
    }
}

/// A file of the folder of examples.
fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples").join(name)
}

/// An output folder whose name a shell, YAML and Kubernetes read in their own ways.
fn strange_folder(name: &str) -> String {
    format!("it's $(x) `y` \"z\" a$$b: #{name}")
}

/// Runs tasks in random order, two at once. Kills a third of them at a random point of their first try. A task that was killed,
/// or that asks for it, is tried again. Returns the exit codes, and how many were killed.
fn run_tasks(
    seed: &str,
    tasks: u32,
    typical: Duration,
    command: impl Fn(u32, u32) -> Command + Sync,
    is_requeued: impl Fn(u32) -> bool + Sync,
) -> (Vec<i32>, usize) {
    let mut rng = Rng::new(7, seed, "tasks");
    let mut order: Vec<u32> = (1..=tasks).collect();
    rng.shuffle(&mut order);
    // A shard takes a fifth of the whole at least, so most are met at work.
    let mut wait = |k| (k % 3 == 0).then(|| typical.mul_f64(rng.uniform(0.0, 1.2) / f64::from(SHARDS)));
    let waits: Vec<_> = order.into_iter().enumerate().map(|(k, task)| (task, 0, wait(k))).collect();
    let (queue, codes, killed) = (Mutex::new(waits), Mutex::new(Vec::new()), Mutex::new(0));
    let work = || {
        loop {
            let Some((task, tries, wait)) = queue.lock().unwrap().pop() else { break };
            let mut child = command(task, tries).spawn().unwrap();
            if let Some(wait) = wait {
                std::thread::sleep(wait);
                if child.try_wait().unwrap().is_none() {
                    let group = format!("-{}", child.id());
                    assert!(Command::new("kill").args(["-9", "--", &group]).status().unwrap().success());
                    *killed.lock().unwrap() += 1;
                }
            }
            match child.wait().unwrap().code() {
                Some(code) if !is_requeued(task) => codes.lock().unwrap().push(code),
                _ => queue.lock().unwrap().insert(0, (task, tries + 1, None)),
            }
        }
    };
    std::thread::scope(|scope| [(); 2].map(|()| scope.spawn(work)).map(|thread| thread.join().unwrap()));
    (codes.into_inner().unwrap(), killed.into_inner().unwrap())
}

#[test]
fn a_slurm_array_with_kills_leaves_the_folder_of_one_run() {
    let cluster = Cluster::new();
    let mut killed = 0;
    for (name, command) in COMMANDS {
        let typical = cluster.whole(name, command);
        let out = strange_folder(name);
        cluster.clear();
        let mut submit = cluster.command("bash");
        submit.arg(example("jobs/slurm.sh")).args([&SHARDS.to_string(), "flaky"]);
        assert!(submit.args(command).args(["--out", &out]).status().unwrap().success());
        let submitted =
            [1, 2, 3].map(|k| fs::read_to_string(cluster.at(&format!("queue/submitted-{k}"))).unwrap());
        let submitted = submitted.each_ref().map(|text| text.split_terminator('\0').collect::<Vec<_>>());
        let option = |name: &str| {
            submitted.each_ref().map(|words| words.iter().find_map(|word| word.strip_prefix(name)))
        };
        // At most three tasks an array, so two arrays, each after the one before, and the join.
        assert_eq!(option("--array="), [Some("1-3%50"), Some("1-2%50"), None], "{name}");
        assert_eq!(option("--dependency="), [None, Some("afterany:1"), Some("afterany:2")], "{name}");
        let firsts = option("--export=ALL,SAGE_FIRST=").map(Option::unwrap);
        assert_eq!(firsts, ["0", "3", "join"]);
        let task_command = |job: usize, task: u32, tries: u32| {
            let script = submitted[job].iter().position(|word| word.ends_with("slurm.sh")).unwrap();
            let mut run = cluster.command("bash");
            run.args(&submitted[job][script..]).env("SAGE_FIRST", firsts[job]);
            run.env("SLURM_CPUS_PER_TASK", "1").env("SLURM_ARRAY_JOB_ID", job.to_string());
            run.env("SLURM_ARRAY_TASK_ID", task.to_string()).env("SLURM_RESTART_COUNT", tries.to_string());
            run
        };
        let mut codes = Vec::new();
        for (job, tasks) in [(0, 3), (1, 2)] {
            let is_requeued =
                |task| fs::remove_file(cluster.at(&format!("queue/requeue-{job}_{task}"))).is_ok();
            let of_job = |task, tries| task_command(job, task, tries);
            let (ended, some) = run_tasks(&format!("{name}{job}"), tasks, typical, of_job, is_requeued);
            codes.extend(ended);
            killed += some;
        }
        codes.sort_unstable();
        assert_eq!(codes, [0, 0, 0, 0, BAD_SCENES], "{name}");
        assert_eq!(task_command(2, 0, 0).status().unwrap().code(), Some(BAD_SCENES), "{name}");
        assert_same(&cluster.at(&out), &cluster.at(&format!("whole-{name}")));
    }
    // How many of them had ended before depends on the machine.
    assert!(killed > 0, "none was killed");
}

#[test]
fn commands_that_make_no_array_are_refused() {
    let wrong = [
        "8 sage generate scenes",
        "x sage generate scenes --out x",
        "8 sage generate scenes --out x --force",
    ];
    for words in wrong.iter().copied().chain(["8 sage generate --out x --shard 1/2", ""]) {
        let mut bash = Command::new("bash");
        let output = bash.arg(example("jobs/slurm.sh")).args(words.split_whitespace()).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{words}: {}", stderr(&output));
    }
}

/// The file with another number of shards, command and folder.
fn kubernetes(command: &[&str], out: &str) -> [Value; 2] {
    let word = |word: &str| Value::from(word.replace('$', "$$")).to_string();
    let words: Vec<String> = ["flaky"].iter().chain(command).map(|text| word(text)).collect();
    let text = fs::read_to_string(example("jobs/kubernetes.yaml")).unwrap();
    let text = text
        .replace("200", &SHARDS.to_string())
        .replace(
            "[sage, generate, scenes/, --format, rows, --no-pages, --quiet, ",
            &format!("[{}, ", words.join(", ")),
        )
        .replace("[sage, join", "[flaky, join")
        .replace("--threads 4", "--threads 1")
        .replace("attacked/]", &format!("{}]", word(out)))
        .replace("attacked/,", &format!("{},", word(out)));
    let documents = text.split("---\n").map(|document| serde_saphyr::from_str(document).unwrap());
    documents.collect::<Vec<Value>>().try_into().unwrap()
}

#[test]
fn an_indexed_job_leaves_the_folder_of_one_run() {
    let cluster = Cluster::new();
    let (name, command) = COMMANDS[0];
    cluster.whole(name, command);
    let out = strange_folder(name);
    let [job, join] = kubernetes(command, &out);
    let run = |job: &Value| {
        let container = &job["spec"]["template"]["spec"]["containers"][0];
        let parts = [&container["command"], &container["args"]].into_iter().filter_map(Value::as_array);
        // Kubernetes reads `$$` as `$`.
        let mut words = parts.flatten().map(|word| word.as_str().unwrap().replace("$$", "$"));
        let mut run = cluster.command(&words.next().unwrap());
        run.args(words);
        run
    };
    let spec = &job["spec"];
    assert_eq!((&spec["completionMode"], &spec["completions"]), (&"Indexed".into(), &SHARDS.into()));
    let fails = &spec["podFailurePolicy"]["rules"][1];
    assert_eq!(
        (&fails["action"], fails["onExitCodes"]["values"].to_string()),
        (&"FailIndex".into(), "[1,2,65]".to_owned())
    );
    let tries = 1 + spec["backoffLimitPerIndex"].as_u64().unwrap();
    let mut codes: Vec<i32> = (0..SHARDS)
        .map(|index| {
            let mut pod = run(&job);
            pod.env("JOB_COMPLETION_INDEX", index.to_string());
            let mut codes = (0..tries).map(|_| pod.status().unwrap().code().unwrap());
            codes.find(|code| [0, 1, 2, BAD_SCENES].contains(code)).unwrap()
        })
        .collect();
    codes.sort_unstable();
    assert_eq!(codes, [0, 0, 0, 0, BAD_SCENES]);
    assert_eq!(
        (run(&join).status().unwrap().code(), &join["spec"]["suspend"]),
        (Some(BAD_SCENES), &true.into())
    );
    assert_same(&cluster.at(&out), &cluster.at(&format!("whole-{name}")));
}

/// Python with `ray` and `kubernetes_validate`, and with `shellcheck` beside it.
fn tools() -> PathBuf {
    std::env::var_os("SAGE_JOBS_PYTHON").unwrap_or_else(|| "python3".into()).into()
}

fn runs(program: &Path, arguments: &[&str]) -> bool {
    let status = Command::new(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}

#[test]
fn scripts_are_what_their_programs_expect() {
    let beside = tools().with_file_name("shellcheck");
    match [beside, "shellcheck".into()].iter().find(|program| runs(program, &["--version"])) {
        None => eprintln!("left out: shellcheck (SAGE_JOBS_PYTHON names a Python beside which it lies)"),
        Some(program) => {
            let output = Command::new(program).arg(example("jobs/slurm.sh")).output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
        }
    }
    if !runs(&tools(), &["-c", "import kubernetes_validate"]) {
        return eprintln!("left out: kubernetes_validate (SAGE_JOBS_PYTHON names a Python that has it)");
    }
    let validate = "import sys, yaml, kubernetes_validate as k
for document in yaml.safe_load_all(open(sys.argv[1])):
    k.validate(document, '1.33', strict=True)";
    let yaml = example("jobs/kubernetes.yaml");
    let output = Command::new(tools()).args(["-c", validate, text(&yaml)]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_worker_of_ray_that_is_killed_costs_nothing() {
    if !runs(&tools(), &["-c", "import ray"]) {
        return eprintln!("left out: Ray (SAGE_JOBS_PYTHON names a Python that has it)");
    }
    let cluster = Cluster::new();
    let (_, command) = COMMANDS[0];
    cluster.whole("ray", command);
    // The first worker that gets shard 2 kills itself before it starts the shard, shard 4 is an input or output error once.
    let killer = cluster.at("bin/killer");
    let script = format!(
        "#!/bin/bash\nshard=${{@: -1}}\ncase $shard in 2/*) if [ ! -e \"$TRIED/killed\" ]; then touch \"$TRIED/killed\"; kill -9 $PPID; exit 1; fi ;; esac\n{}",
        fs::read_to_string(cluster.at("bin/flaky")).unwrap().replace("#!/bin/bash\n", "")
    );
    fs::write(&killer, script).unwrap();
    fs::set_permissions(&killer, fs::Permissions::from_mode(0o755)).unwrap();
    let output = cluster
        .command(text(&tools()))
        .env("SAGE_CORES", "1")
        .args([text(&example("ray_shards.py")), "5", text(&killer)])
        .args(command)
        .args(["--out", "parts-ray"])
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(BAD_SCENES), "{}", stderr(&output));
    assert!(cluster.at("tried/killed").exists() && cluster.at("tried/4-5").exists());
    assert_same(&cluster.at("parts-ray"), &cluster.at("whole-ray"));
    // Begun by Ray, finished without it.
    let rest = cluster.at("parts-rest");
    for shard in ["1/5", "2/5"] {
        sage_in(cluster.root.path(), &[command, &["--out", text(&rest), "--shard", shard]].concat());
    }
    let whole = sage_in(cluster.root.path(), &[command, &["--out", text(&rest)]].concat());
    assert_eq!(whole.status.code(), Some(BAD_SCENES), "{}", stderr(&whole));
    assert_same(&rest, &cluster.at("whole-ray"));
}
