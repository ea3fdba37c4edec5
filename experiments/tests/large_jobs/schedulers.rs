//! The scripts that `sage jobs` prints, run as a cluster runs them.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    os::unix::{fs::PermissionsExt as _, process::CommandExt as _},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::Mutex,
    time::{Duration, Instant},
};

use insta::assert_snapshot;
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
printf '%s\n' "$*" >> "$QUEUE/submitted"
wc -l < "$QUEUE/submitted"
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

    fn script(&self, scheduler: &[&str], command: &[&str], out: &str) -> String {
        let flaky = self.at("bin/flaky");
        let shards = SHARDS.to_string();
        let job = [&["jobs"], scheduler, &["--shards", &shards, "--at-once", "2", "--cores", "1"]].concat();
        let program = ["--program", text(&flaky), "--"];
        stdout(&sage(&[&job, &program[..], command, &["--out", out]].concat())).to_owned()
    }
}

/// What a scheduler makes of the end of a task.
enum Next {
    Again,
    Ended(i32),
}

/// Runs tasks in random order, two at once. Kills a third of them at a random point of their first try; a killed task is
/// tried again. Returns how each ended, and how many were killed.
fn run_tasks(
    seed: &str,
    tasks: &[u32],
    typical: Duration,
    command: impl Fn(u32, u32) -> Command + Sync,
    next: impl Fn(u32, Option<i32>, u32) -> Next + Sync,
) -> (BTreeMap<u32, i32>, usize) {
    let mut order = tasks.to_vec();
    let mut rng = Rng::new(7, seed, "tasks");
    rng.shuffle(&mut order);
    let mut waits: Vec<(u32, u32, Option<Duration>)> = order.iter().map(|task| (*task, 0, None)).collect();
    for (k, (.., wait)) in waits.iter_mut().enumerate() {
        if k % 3 == 0 {
            // A shard takes a fifth of the whole at least, so most are met at work.
            *wait = Some(typical.mul_f64(rng.uniform(0.0, 1.2) / f64::from(SHARDS)));
        }
    }
    let (queue, ended, killed) = (Mutex::new(waits), Mutex::new(BTreeMap::new()), Mutex::new(0));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let Some((task, tries, wait)) = queue.lock().unwrap().pop() else { break };
                    let mut child = command(task, tries).spawn().unwrap();
                    if let Some(wait) = wait {
                        std::thread::sleep(wait);
                        if child.try_wait().unwrap().is_none() {
                            let group = format!("-{}", child.id());
                            let kill = Command::new("kill").args(["-9", "--", &group]).status();
                            assert!(kill.unwrap().success());
                            *killed.lock().unwrap() += 1;
                        }
                    }
                    let code = child.wait().unwrap().code();
                    match next(task, code, tries) {
                        Next::Again => queue.lock().unwrap().insert(0, (task, tries + 1, None)),
                        Next::Ended(code) => drop(ended.lock().unwrap().insert(task, code)),
                    }
                }
            });
        }
    });
    (ended.into_inner().unwrap(), killed.into_inner().unwrap())
}

/// The value of an option among words such as `--array=1-3%2`.
fn option<'w>(words: &'w str, name: &str) -> Option<&'w str> {
    let start = format!("{name}=");
    words.split(' ').find_map(|word| word.strip_prefix(&*start))
}

#[test]
fn a_slurm_array_with_kills_leaves_the_folder_of_one_run() {
    let cluster = Cluster::new();
    let mut killed = 0;
    for (name, command) in COMMANDS {
        let typical = cluster.whole(name, command);
        let out = format!("parts-{name}");
        let job = cluster.at("job.sh");
        fs::write(&job, cluster.script(&["slurm"], command, &out)).unwrap();
        fs::remove_dir_all(cluster.at("tried")).unwrap();
        fs::create_dir(cluster.at("tried")).unwrap();
        let _ = fs::remove_file(cluster.at("queue/submitted"));
        assert!(cluster.command("bash").arg(&job).status().unwrap().success());
        let submitted = fs::read_to_string(cluster.at("queue/submitted")).unwrap();
        let submitted: Vec<&str> = submitted.lines().collect();
        // At most three tasks an array, so two arrays, each after the one before, and the join.
        let arrays: Vec<Option<&str>> = submitted.iter().map(|words| option(words, "--array")).collect();
        assert_eq!(arrays, [Some("1-3%2"), Some("1-2%2"), None], "{name}");
        let after: Vec<Option<&str>> = submitted.iter().map(|words| option(words, "--dependency")).collect();
        assert_eq!(after, [None, Some("afterany:1"), Some("afterany:2")], "{name}");
        let mut codes = Vec::new();
        for (number, words) in submitted.iter().enumerate() {
            let first = option(words, "--export").unwrap().strip_prefix("ALL,SAGE_FIRST=").unwrap();
            let task_command = |task: u32, tries: u32| {
                let mut run = cluster.command("bash");
                run.arg(&job).env("SLURM_JOB_ID", "9").env("SAGE_FIRST", first);
                run.env("SLURM_ARRAY_JOB_ID", number.to_string())
                    .env("SLURM_ARRAY_TASK_ID", task.to_string());
                run.env("SLURM_RESTART_COUNT", tries.to_string());
                run
            };
            let Some((_, last)) = option(words, "--array").and_then(|array| array.split_once('-')) else {
                let joined = task_command(0, 0).status().unwrap();
                assert_eq!((first, joined.code()), ("join", Some(BAD_SCENES)), "{name}");
                continue;
            };
            let tasks: Vec<u32> = (1..=last.split('%').next().unwrap().parse().unwrap()).collect();
            let next = |task: u32, code: Option<i32>, _: u32| {
                let requeue = cluster.at(&format!("queue/requeue-{number}_{task}"));
                // A killed task is requeued by Slurm, another by its own wish.
                match code {
                    Some(0) if fs::remove_file(&requeue).is_ok() => Next::Again,
                    Some(code) => Next::Ended(code),
                    None => Next::Again,
                }
            };
            let (ended, some) = run_tasks(&format!("{name}{number}"), &tasks, typical, task_command, next);
            codes.extend(ended.into_values());
            killed += some;
        }
        assert_eq!(codes.iter().collect::<BTreeSet<_>>(), [&0, &BAD_SCENES].into(), "{name}");
        assert_eq!((codes.len(), codes.iter().filter(|code| **code != 0).count()), (SHARDS as usize, 1));
        assert_same(&cluster.at(&out), &cluster.at(&format!("whole-{name}")));
    }
    // How many of them had ended before depends on the machine.
    assert!(killed > 0, "none was killed");
}

#[test]
fn an_indexed_job_with_kills_leaves_the_folder_of_one_run() {
    let cluster = Cluster::new();
    for (name, command) in COMMANDS {
        let typical = cluster.whole(name, command);
        let out = format!("parts-{name}");
        let script = cluster.script(&["kubernetes", "--image", "sage:1", "--claim", "scenes"], command, &out);
        let documents: Vec<Value> =
            script.split("---\n").map(|document| serde_saphyr::from_str(document).unwrap()).collect();
        let [job, join] = &documents[..] else { panic!("{} documents", documents.len()) };
        let container = |job: &Value| job["spec"]["template"]["spec"]["containers"][0].clone();
        let shell = |job: &Value| {
            let words = container(job)["command"].as_array().unwrap().clone();
            assert_eq!([&words[0], &words[1]], ["sh", "-c"]);
            // Kubernetes reads `$$` as `$`.
            words[2].as_str().unwrap().replace("$$", "$")
        };
        let spec = &job["spec"];
        assert_eq!((&spec["completionMode"], &spec["completions"]), (&"Indexed".into(), &SHARDS.into()));
        let rules = spec["podFailurePolicy"]["rules"].as_array().unwrap();
        let fails: Vec<i64> = rules[1]["onExitCodes"]["values"]
            .as_array()
            .unwrap()
            .iter()
            .map(|code| code.as_i64().unwrap())
            .collect();
        assert_eq!((&rules[1]["action"], &fails[..]), (&"FailIndex".into(), &[1, 2, 65][..]));
        let limit = spec["backoffLimitPerIndex"].as_u64().unwrap() as u32;
        let line = shell(job);
        fs::remove_dir_all(cluster.at("tried")).unwrap();
        fs::create_dir(cluster.at("tried")).unwrap();
        let pod = |index: u32, _: u32| {
            let mut run = cluster.command("sh");
            run.args(["-c", &line]).env("JOB_COMPLETION_INDEX", index.to_string());
            run
        };
        let next = |index: u32, code: Option<i32>, tries: u32| match code {
            Some(0) => Next::Ended(0),
            Some(code) if fails.contains(&i64::from(code)) => Next::Ended(code),
            _ => {
                assert!(tries < limit, "{name}: index {index} failed too often");
                Next::Again
            }
        };
        let indices: Vec<u32> = (0..SHARDS).collect();
        let (ended, _) = run_tasks(name, &indices, typical, pod, next);
        assert_eq!(ended.values().filter(|code| **code == BAD_SCENES).count(), 1, "{name}: {ended:?}");
        assert_eq!(ended.len(), SHARDS as usize);
        let joined = cluster.command("sh").args(["-c", &shell(join)]).status().unwrap();
        assert_eq!((joined.code(), &join["spec"]["suspend"]), (Some(BAD_SCENES), &true.into()));
        assert_same(&cluster.at(&out), &cluster.at(&format!("whole-{name}")));
    }
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
fn printed_scripts_are_what_their_programs_expect() {
    let folder = tempfile::tempdir().unwrap();
    // Words that a shell, YAML and Kubernetes read in their own ways.
    let command =
        ["generate", "my scenes/it's", "--adversary", "$(x) `y` \"z\" @JOIN@ a$$b", "--out", "out: #1"];
    let script = |arguments: &[&str]| {
        stdout(&sage(&[&["jobs"], arguments, &["--shards", "2500", "--"], &command].concat())).to_owned()
    };
    let slurm = script(&["slurm"]);
    let kubernetes = script(&["kubernetes", "--image", "registry/sage:1", "--claim", "scenes"]);
    assert_snapshot!("slurm", slurm);
    assert_snapshot!("kubernetes", kubernetes);
    let [job, yaml] = [("job.sh", slurm), ("job.yaml", kubernetes)].map(|(name, text)| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    });
    assert!(runs(Path::new("bash"), &["-n", text(&job)]));
    let beside = tools().with_file_name("shellcheck");
    match [beside, "shellcheck".into()].iter().find(|program| runs(program, &["--version"])) {
        None => eprintln!("left out: shellcheck (SAGE_JOBS_PYTHON names a Python beside which it lies)"),
        Some(program) => {
            // Of the strange words it notes that they are not expanded, which is meant.
            let usual = script(&["slurm"]).replace("'$(x) `y` \"z\" @JOIN@ a$$b'", "usual");
            let path = folder.path().join("usual.sh");
            fs::write(&path, usual).unwrap();
            for (severity, job) in [("warning", &job), ("style", &path)] {
                let output = Command::new(program).args(["-S", severity, text(job)]).output().unwrap();
                assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
            }
        }
    }
    let validate = "import sys, yaml, kubernetes_validate as k
for document in yaml.safe_load_all(open(sys.argv[1])):
    k.validate(document, '1.33', strict=True)";
    if !runs(&tools(), &["-c", "import kubernetes_validate"]) {
        return eprintln!("left out: kubernetes_validate (SAGE_JOBS_PYTHON names a Python that has it)");
    }
    let output = Command::new(tools()).args(["-c", validate, text(&yaml)]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn commands_that_make_no_job_are_refused() {
    let wrong: [&[&str]; 6] = [
        &["list"],
        &["generate", "scenes", "--out", "x", "--shard", "1/2"],
        &["generate", "scenes", "--out", "x", "--threads", "2"],
        &["generate", "scenes", "--out", "x", "--force"],
        &["generate", "scenes"],
        &["generat", "scenes", "--out", "x"],
    ];
    let said = wrong.map(|command| {
        let output = sage(&[&["jobs", "slurm", "--shards", "3", "--"], command].concat());
        let code = output.status.code().unwrap();
        (command.join(" "), format!("{}exit status {code}\n", stderr(&output)))
    });
    assert_snapshot!("wrong_jobs", messages(said));
    let unnamed = sage(&["jobs", "kubernetes", "--shards", "3", "--", "list"]);
    assert_eq!(unnamed.status.code(), Some(2), "{}", stderr(&unnamed));
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
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/ray_shards.py");
    let output = cluster
        .command(text(&tools()))
        .env("SAGE_CORES", "1")
        .args([text(&example), "5", text(&killer)])
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
