//! Checkpoints that are damaged, foreign or crafted: refused by name, never used.

mod short_training;

use std::path::Path;

use insta::assert_snapshot;
use safetensors::SafeTensors;
use sage_core::content_hash::{HashedTensor, content_hash, split_hash, with_hash};
use sage_learn::{BUFFER, CHECKPOINT, Training, TrainingOptions, TrainingState};
use short_training::{Parts, scenes, small};

#[test]
fn a_damaged_or_foreign_checkpoint_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = small();
    let load = |identity: &str| {
        TrainingState::load(folder.path(), identity, &options, 6).map(|found| found.is_some())
    };
    assert_eq!(load("a"), Ok(false));
    let mut state = TrainingState::new(&options, 6).expect("valid options");
    state.save(folder.path(), "a").expect("written");
    assert_eq!(load("a"), Ok(true));
    let told = |identity: &str| in_folder(folder.path(), &load(identity).expect_err("a refusal").to_string());
    assert_snapshot!(told("b"), @"`[folder]/checkpoint.safetensors`: it is of a run with other options, scenes or weights; give --force to start again");
    let path = folder.path().join(CHECKPOINT);
    let whole = std::fs::read(&path).expect("the checkpoint");
    for cut in [0, 7, 100, whole.len() / 2, whole.len() - 1] {
        std::fs::write(&path, &whole[..cut]).expect("written");
        let error = load("a").expect_err("cut").to_string();
        assert!(error.contains(CHECKPOINT), "{error}");
    }
    let mut flipped = whole.clone();
    let last = flipped.len() - 3;
    flipped[last] ^= 1;
    std::fs::write(&path, flipped).expect("written");
    assert_snapshot!(told("a"), @"`[folder]/checkpoint.safetensors`: its content does not match the hash in its header: the file is damaged or was changed; copy or make it again; give --force to start again");
    std::fs::write(&path, whole).expect("written");
    assert_eq!(load("a"), Ok(true));
}

#[test]
fn a_damaged_replay_buffer_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = small();
    save_trained(folder.path(), &options);
    let load = || TrainingState::load(folder.path(), "test", &options, 6).map(|found| found.is_some());
    assert_eq!(load(), Ok(true));
    let told = || in_folder(folder.path(), &load().expect_err("a refusal").to_string());
    let file = std::fs::read_dir(folder.path().join(BUFFER)).expect("a folder").next().expect("a file");
    let file = file.expect("an entry").path();
    let whole = std::fs::read(&file).expect("rows");
    for position in [0, 5, whole.len() / 2, whole.len() - 1] {
        let mut flipped = whole.clone();
        flipped[position] ^= 1;
        std::fs::write(&file, flipped).expect("written");
        insta::allow_duplicates! { assert_snapshot!(told(), @"`[folder]/buffer/000000000000.rows`: its content does not match the hash in the checkpoint: it is damaged; give --force to start again") };
    }
    std::fs::write(&file, &whole[..whole.len() - 4]).expect("written");
    assert_snapshot!(told(), @"`[folder]/buffer/000000000000.rows`: its content does not match the hash in the checkpoint: it is damaged; give --force to start again");
    std::fs::write(&file, [&whole[..], &[0; 420]].concat()).expect("written");
    assert_snapshot!(told(), @"`[folder]/buffer/000000000000.rows`: it holds more than 128100 bytes, the most that is read; give --force to start again");
    std::fs::remove_file(&file).expect("removed");
    assert_snapshot!(told(), @"`[folder]/buffer/000000000000.rows`: No such file or directory (os error 2); give --force to start again");
}

/// A message without the path of a folder.
fn in_folder(folder: &Path, message: &str) -> String {
    message.replace(&folder.display().to_string(), "[folder]")
}

/// A message with `#` for its numbers, some of which depend on the length of the episodes.
fn without_numbers(message: &str) -> String {
    let masked = |word: &str| match word.trim_end_matches(';') {
        number if number.parse::<u64>().is_ok() => word.replace(number, "#"),
        _ => word.to_owned(),
    };
    message.split(' ').map(masked).collect::<Vec<_>>().join(" ")
}

/// Trains for a while and saves the run.
fn save_trained(folder: &Path, options: &TrainingOptions) {
    let (training, evaluation) = (scenes(6, 0), scenes(3, 1));
    let parts = Parts::of("constant", "uniform");
    let state = TrainingState::new(options, training.len()).expect("valid options");
    let mut run = Training::new(options.clone(), parts.setting(&training, &evaluation), state);
    run.advance(300, |_| ()).expect("nothing breaks");
    run.save(folder, "test").expect("written");
}

#[test]
fn a_crafted_checkpoint_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = small();
    save_trained(folder.path(), &options);
    let path = folder.path().join(CHECKPOINT);
    let whole = std::fs::read(&path).expect("the checkpoint");
    let crafted = |pointer: &str, value: serde_json::Value| {
        let changed = with_changed_record(&whole, |record| {
            *record.pointer_mut(pointer).unwrap_or_else(|| panic!("no {pointer}")) = value;
        });
        std::fs::write(&path, changed).expect("written");
        TrainingState::load(folder.path(), "test", &options, 6).map(|found| found.is_some())
    };
    assert_eq!(crafted("/learner/diverging", 0.into()), Ok(true), "the crafted file has the right hash");
    let huge = serde_json::Value::from(u64::MAX);
    let mut told = Vec::new();
    for counter in ["steps", "episodes", "attacked", "skipped", "drive_age", "without_drive", "unavoidable"] {
        let error = crafted(&format!("/counters/{counter}"), huge.clone()).expect_err(counter).to_string();
        assert!(error.contains(counter), "{counter}: {error}");
        told.push(format!("{counter} -> {}", without_numbers(&in_folder(folder.path(), &error))));
    }
    for (pointer, value) in [
        ("/records", serde_json::json!([])),
        ("/records/0/visits", huge.clone()),
        ("/learner/updates", huge.clone()),
        ("/learner/written", huge.clone()),
        ("/learner/written", 0.into()),
        ("/learner/buffer", serde_json::json!([])),
        ("/learner/buffer/0/first", huge.clone()),
        ("/learner/buffer/0/first", 1.into()),
        ("/learner/buffer/0/rows", huge.clone()),
        ("/success/rates/0", 1e300.into()),
        ("/drives", serde_json::json!([[0, u64::MAX, 0]])),
        ("/drives", serde_json::json!([[99, 0, 0]])),
        ("/drives", serde_json::json!([[0, 0, u64::MAX]])),
        ("/loss_curve", serde_json::json!(vec![[0.0; 3]; 100])),
        ("/learner/diverging", u32::MAX.into()),
        ("/learner/rows", serde_json::json!([])),
        ("/learner/rows/0", huge.clone()),
        ("/learner/losses/0", serde_json::Value::Null),
        ("/learner", serde_json::Value::Null),
        ("/episodes", serde_json::json!([null, null])),
        ("/episodes/0/scene", 99.into()),
        ("/episodes/0/actions/0/0", 1e300.into()),
        ("/format", "sage train-ego checkpoint 1".into()),
    ] {
        let error = crafted(pointer, value.clone()).expect_err(pointer).to_string();
        let mut value = value.to_string();
        value.truncate(30);
        told.push(format!("{pointer} {value} -> {}", without_numbers(&in_folder(folder.path(), &error))));
    }
    assert_snapshot!("crafted_checkpoints", told.join("\n"));
}

/// A checkpoint with a changed record and the hash of its new content.
fn with_changed_record(whole: &[u8], change: impl FnOnce(&mut serde_json::Value)) -> Vec<u8> {
    let (_, header) = SafeTensors::read_metadata(whole).expect("whole");
    let (json, _) = split_hash(&header.metadata().as_ref().expect("a header")["checkpoint"]);
    let mut record: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    change(&mut record);
    let json = record.to_string();
    let file = SafeTensors::deserialize(whole).expect("whole");
    let tensors = || file.iter();
    let hashed = tensors().map(|(name, tensor)| {
        let dtype = format!("{:?}", tensor.dtype());
        (name, HashedTensor { dtype, shape: tensor.shape().to_vec(), bytes: tensor.data() })
    });
    let text = with_hash(&json, &content_hash(&json, hashed));
    let views = file.tensors();
    let header = [("checkpoint".to_owned(), text)].into_iter().collect();
    safetensors::serialize(views, Some(header)).expect("written")
}
