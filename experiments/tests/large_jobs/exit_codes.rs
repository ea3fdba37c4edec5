//! The exit codes that a scheduler decides by.

use sage_core::files::OutputLock;

use super::*;

#[test]
fn exit_codes_say_whether_another_try_helps() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 3);
    std::fs::create_dir(root.join("bad")).unwrap();
    std::fs::copy(root.join("scenes/broken.pkl"), root.join("bad/broken.pkl")).unwrap();
    let code = |arguments: &[&str]| sage_in(root, arguments).status.code().unwrap();
    let mut number = 0;
    let mut into_new = |arguments: &[&str]| {
        number += 1;
        code(&[arguments, &["--out", &format!("out{number}")]].concat())
    };
    for (name, command) in COMMANDS {
        assert_eq!(into_new(command), BAD_SCENES, "{name}, one scene is bad");
        let [all_bad, good, missing] = ["bad", "scenes/curve-1-1.pkl", "nowhere"].map(|scenes| {
            let words: Vec<&str> =
                command.iter().map(|word| if *word == "scenes" { scenes } else { *word }).collect();
            into_new(&words)
        });
        assert_eq!((all_bad, good, missing), (BAD_SCENES, 0, 1), "{name}");
        assert_eq!(into_new(&[command, &["--no-such-option"]].concat()), 2, "{name}");
    }
    let generate = ["generate", "scenes", "--out", "out", "--weights"];
    assert_eq!(code(&[&generate[..], &["nowhere"]].concat()), 1, "weights that are not there");
    // Commands that list or train on what is good.
    for command in [
        &["inspect", "scenes"][..],
        &["pretrain", "scenes", "--epochs", "1", "--network", r#"{"hidden": 16, "rounds": 1}"#, "--out", "w"],
    ] {
        assert_eq!(code(command), BAD_SCENES, "{command:?}");
    }
    // One scene that is bad ends a command that is of one scene.
    assert_eq!(code(&["draw", "bad/broken.pkl", "--out", "bad.svg"]), 1);
    // Another process has the folder.
    let held = root.join("held");
    std::fs::create_dir(&held).unwrap();
    let lock = OutputLock::folder(&held, "another").unwrap();
    for shard in [&[][..], &["--shard", "1/2"]] {
        let words = [&["generate", "scenes", "--out", "held"], shard].concat();
        assert_eq!(code(&words), RETRY, "a folder in use");
    }
    drop(lock);
}

#[test]
fn a_scene_that_the_system_refuses_is_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 3);
    // A link to a file that is removed after it was listed cannot be made here; a link to nothing in a list can.
    hostile::summary(&root.join("scenes"), &[("curve-1-1.pkl", ""), ("gone.pkl", "")]);
    let generate = ["generate", "scenes", "--format", "rows", "--weights", "procedural", "--out", "out"];
    let first = sage_in(root, &generate);
    assert_eq!(first.status.code(), Some(RETRY), "{}", stderr(&first));
    let manifest = std::fs::read_to_string(root.join("out/manifest.jsonl")).unwrap();
    assert!(manifest.contains("\"state\":\"retry\"") && manifest.contains("\"retry\":1"), "{manifest}");
    std::fs::copy(root.join("scenes/straight-1-0.pkl"), root.join("scenes/gone.pkl")).unwrap();
    assert_eq!(sage_in(root, &generate).status.code(), Some(0));
}
