//! Names inside a folder that this program owns: creating folders and removing files without following links.

use std::{
    io::{self, ErrorKind},
    path::{Component, Path, PathBuf},
};

use super::write::ignore_missing;

/// Creates a folder inside an existing folder, with the folders between them. Returns its path.
///
/// *Errors*: those of the system; [`ErrorKind::InvalidInput`] if the name leads out of the folder, or if a part of it
/// is a link.
pub fn create_inside(root: &Path, name: &Path) -> io::Result<PathBuf> {
    check_name(root, name)?;
    let mut path = root.to_owned();
    for part in name.components() {
        path.push(part);
        match std::fs::create_dir(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            done => done?,
        }
        // Checked before anything is created below it.
        refuse_link(&path)?;
    }
    Ok(path)
}

/// Removes a file, a link or a folder with all its content, if it is there. A link is removed, never followed.
///
/// *Errors*: as [`create_inside`].
pub fn remove_inside(root: &Path, name: &Path) -> io::Result<()> {
    check_folders(root, name)?;
    let path = root.join(name);
    match path.symlink_metadata() {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
        // Links inside are removed as links.
        Ok(found) if found.is_dir() => ignore_missing(std::fs::remove_dir_all(&path)),
        Ok(_) => ignore_missing(std::fs::remove_file(&path)),
    }
}

/// Refuses a name inside a folder if it leads out of it, or if a folder on the way to it is a link.
///
/// *Errors*: [`ErrorKind::InvalidInput`].
pub fn check_folders(root: &Path, name: &Path) -> io::Result<()> {
    check_name(root, name)?;
    let mut path = root.to_owned();
    let folders = name.parent().into_iter().flat_map(Path::components);
    folders.into_iter().try_for_each(|part| {
        path.push(part);
        refuse_link(&path)
    })
}

fn check_name(root: &Path, name: &Path) -> io::Result<()> {
    let mut parts = name.components();
    if name.as_os_str().is_empty() || !parts.all(|part| matches!(part, Component::Normal(_))) {
        let problem = format!("`{}` does not lie in `{}`", name.display(), root.display());
        return Err(io::Error::new(ErrorKind::InvalidInput, problem));
    }
    Ok(())
}

fn refuse_link(path: &Path) -> io::Result<()> {
    if path.is_symlink() {
        let problem = format!("`{}` is a link; remove it, or name another output", path.display());
        return Err(io::Error::new(ErrorKind::InvalidInput, problem));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_files_are_created_and_removed_inside() {
        let root = tempfile::tempdir().unwrap();
        let path = create_inside(root.path(), "a/b".as_ref()).unwrap();
        assert!(path.is_dir() && path.ends_with("a/b"));
        std::fs::write(path.join("c"), "x").unwrap();
        remove_inside(root.path(), "a/b/c".as_ref()).unwrap();
        remove_inside(root.path(), "a/none".as_ref()).unwrap();
        std::fs::write(path.join("d"), "x").unwrap();
        remove_inside(root.path(), "a".as_ref()).unwrap();
        assert!(!root.path().join("a").exists());
        for bad in ["", "..", "../x", "a/../../x", "/x", "."] {
            assert!(create_inside(root.path(), bad.as_ref()).is_err(), "{bad}");
            assert!(remove_inside(root.path(), bad.as_ref()).is_err(), "{bad}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_are_removed_and_never_followed() {
        use std::os::unix::fs::symlink;
        let (root, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let precious = outside.path().join("precious");
        std::fs::write(&precious, "x").unwrap();
        symlink(outside.path(), root.path().join("folder")).unwrap();
        symlink(&precious, root.path().join("file")).unwrap();
        assert!(create_inside(root.path(), "folder/new".as_ref()).is_err());
        assert!(remove_inside(root.path(), "folder/precious".as_ref()).is_err());
        assert!(check_folders(root.path(), "folder/precious".as_ref()).is_err());
        std::fs::create_dir(root.path().join("real")).unwrap();
        symlink(outside.path(), root.path().join("real/link")).unwrap();
        for name in ["folder", "file", "real"] {
            remove_inside(root.path(), name.as_ref()).unwrap();
            assert!(!root.path().join(name).is_symlink());
        }
        assert_eq!(std::fs::read_dir(outside.path()).unwrap().count(), 1);
        assert_eq!(std::fs::read(&precious).unwrap(), b"x");
    }
}
