//! The page of `sage studio` in a real browser. Left out, with a note, where there is no Chromium with ChromeDriver.

#![allow(clippy::print_stderr, clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "studio/browser.rs"]
mod browser;
mod studio;

use std::{fs, path::Path};

use browser::Browser;
use serde_json::{Value, json};
use studio::Studio;

const ESCAPE: &str = "\u{E00C}";
const LEFT: &str = "\u{E012}";

/// The page with its first drives.
fn opened(width: u32, height: u32) -> Option<(Studio, Browser, tempfile::TempDir)> {
    let browser = Browser::start(width, height)?;
    let folder = tempfile::tempdir().unwrap();
    let studio = Studio::start(&["--procedural", "7", "--ego", "idm,expert"], folder.path());
    browser.open(&studio.link());
    browser.wait("document.body.dataset.drawn");
    Some((studio, browser, folder))
}

/// Does something, and waits until its drives are drawn.
fn drawn(browser: &Browser, action: impl FnOnce()) {
    let before = browser.run("return document.body.dataset.drawn");
    action();
    browser.wait(&format!("document.body.dataset.drawn > {}", before.as_str().unwrap()));
    browser.wait("!pending");
}

fn command(browser: &Browser) -> String {
    browser.run("return element('command').textContent").as_str().unwrap().to_owned()
}

/// A place of the screen of the first drive, for a place in metres from the origin of the page.
fn on_screen(browser: &Browser, place: &str) -> [f64; 2] {
    let script = format!(
        "const p = panels[0], at = {place}, box = p.canvas.getBoundingClientRect();
         return [box.left + box.width / 2 + (at.x - p.middle.x) * view.scale, box.top + box.height / 2 - (at.y - p.middle.y) * view.scale]"
    );
    serde_json::from_value(browser.run(&script)).unwrap()
}

#[test]
fn a_person_tries_an_attack_with_the_mouse() {
    let Some((_studio, browser, _folder)) = opened(1280, 900) else { return };
    assert_eq!(browser.run("return panels.map((p) => p.name)"), json!(["idm", "expert"]));
    let first = command(&browser);
    assert!(first.contains("--lambda 1 ") && first.contains("--ego idm --ego expert"), "{first}");

    // The slider.
    drawn(&browser, || {
        browser.run("element('dial').value = 4; element('dial').dispatchEvent(new Event('input'))");
    });
    assert!(command(&browser).contains("--lambda 0.2 "), "{}", command(&browser));

    // The end of the plan is dragged away and goes to the nearest one.
    browser.run("seek(now); follow('adversary'); for (let k = 0; k < 14; k++) zoom(0.8)");
    browser.wait("!waiting && view.scale < 3");
    let end = on_screen(&browser, "endOf(p)");
    drawn(&browser, || browser.drag(&[end, [end[0] + 10.0, end[1] + 5.0], [end[0] + 40.0, end[1] + 25.0]]));
    assert!(command(&browser).contains("--goal "), "{}", command(&browser));
    drawn(&browser, || {
        browser.run("element('no-goal').click()");
    });
    assert!(!command(&browser).contains("--goal "));

    // A click on a road user: it goes, it comes back, it attacks.
    let id = "scene.bodies.find(({ id, body }) => id !== scene.adversary && pose(body, view.time) && scene.users.find((u) => u.id === id)?.canAttack)";
    let other = browser.run(&format!("return {id}.id")).as_str().unwrap().to_owned();
    browser.run(&format!("view.centre = pose({id}.body, view.time); view.follow = 'free'; redraw()"));
    browser.wait("!waiting");
    let place = on_screen(&browser, &format!("pose({id}.body, view.time)"));
    browser.drag(&[place, place]);
    browser.wait("!element('menu').hidden");
    assert_eq!(
        browser.run("return element('menu').innerText"),
        json!(format!("attack with {other}\ntake {other} away"))
    );
    drawn(&browser, || {
        browser.run("element('menu').lastChild.click()");
    });
    assert!(command(&browser).contains(&format!("--without {other} ")), "{}", command(&browser));
    drawn(&browser, || {
        browser.run(
            "[...document.querySelectorAll('#users button')].find((b) => b.textContent === 'back').click()",
        );
    });
    assert!(!command(&browser).contains("--without"));
    drawn(&browser, || {
        browser.run(&format!("attackWith({})", json!(other)));
    });
    assert!(command(&browser).contains(&format!("--adversary {other} ")), "{}", command(&browser));
    assert_eq!(browser.run("return scene.adversary"), json!(other));

    // A drive that is shown alone stays so.
    browser.run("alone(panels[1])");
    drawn(&browser, || {
        browser.run("element('dial').value = 9; element('dial').dispatchEvent(new Event('input'))");
    });
    assert_eq!(browser.run("return panels.map((p) => p.box.hidden)"), json!([true, false]));
    browser.run("alone(null)");

    // One driver alone, another scene.
    drawn(&browser, || {
        browser.run("element('second').value = ''; element('second').dispatchEvent(new Event('change'))");
    });
    assert_eq!(browser.run("return panels.length"), 1);
    drawn(&browser, || {
        browser.run("element('scenes').children[3].click()");
    });
    assert!(command(&browser).contains("four-way-0-3") && !command(&browser).contains("--adversary"));
    // Nothing of the scene before is left on the map.
    let picture = "return panels[0].canvas.toDataURL()";
    browser.wait("!waiting");
    let drawn_once = browser.run(picture);
    browser.run("tiles.clear(); redraw()");
    browser.wait("!waiting");
    assert!(browser.run(picture) == drawn_once, "the map is that of the scene");
    // The list shows what the scenes look like.
    browser
        .wait("[...document.querySelectorAll('#scenes img')].slice(0, 3).every((e) => e.naturalWidth > 1)");
    // All plots have one cursor, which steps by 0.1 s.
    assert_eq!(browser.run("return shownPlots().length"), 5);
    browser.run("document.activeElement.blur()");
    let time = browser.run("return view.time").as_f64().unwrap();
    browser.press(LEFT);
    assert_eq!(browser.run("return view.time"), time - 1.0);
    assert_eq!(browser.messages(), "");
}

/// Whether `sage test` passes the suite that was kept.
fn passes(suite: &Path, driver: &str) -> Option<i32> {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_sage"));
    command.arg("test").arg(suite).args(["--ego", driver]).output().unwrap().status.code()
}

#[test]
fn a_person_finds_a_failure_and_keeps_it() {
    let Some(browser) = Browser::start(1280, 900) else { return };
    let folder = tempfile::tempdir().unwrap();
    let studio =
        Studio::start(&["--procedural", "3", "--ego", "idm,expert", "--out", "suite"], folder.path());
    browser.open(&studio.link());
    browser.wait("document.body.dataset.drawn");
    drawn(&browser, || {
        browser.run("element('scenes').children[2].click()");
    });
    // Why it is no failure is said once nothing changes any more, and what becomes of the other places of the slider.
    browser.wait("element('why').innerText.includes('No failure: ')");
    browser.wait("places.size === offered.steps");
    assert!(
        browser.run("return element('places-legend').textContent").as_str().unwrap().starts_with("idm: ")
    );
    browser.run("element('search').click()");
    browser.wait("!isSearching");
    let said = browser.run("return element('searched').textContent");
    assert!(said.as_str().unwrap().contains(" failures in 64 drives"), "{said}");
    drawn(&browser, || {
        browser.run("element('found').querySelector('button').click()");
    });
    assert!(command(&browser).contains("--attack found/merge-0-2-failure1.json"), "{}", command(&browser));
    browser.wait("element('why').innerText.includes('idm: A failure. The driver of UN R157 would ')");
    browser.run("element('keep').click()");
    browser.wait("element('kept').textContent");
    let kept = browser.run("return element('kept').textContent");
    assert!(kept.as_str().unwrap().starts_with("kept as merge-0-2-idm-failure1"), "{kept}");
    assert_eq!(passes(&folder.path().join("suite"), "idm"), Some(1));
    // The slider goes back to the generator; a newer wish ends a search.
    drawn(&browser, || {
        browser.run("element('dial').value = 8; element('dial').dispatchEvent(new Event('input'))");
    });
    assert!(command(&browser).contains("--lambda 0.4 "), "{}", command(&browser));
    browser.run("element('search').click()");
    browser.wait("element('progress').value > 0 || !isSearching");
    drawn(&browser, || {
        browser.run("element('dial').value = 10; element('dial').dispatchEvent(new Event('input'))");
    });
    browser.wait("!isSearching");
    let said = browser.run("return element('searched').textContent");
    assert!(said.as_str().unwrap().contains(" drives"), "{said}");
    assert_eq!(browser.messages(), "");
}

#[test]
fn an_address_holds_the_view_and_starts_no_program() {
    let Some(browser) = Browser::start(1280, 900) else { return };
    let folder = tempfile::tempdir().unwrap();
    // It writes a line for each start.
    fs::write(folder.path().join("planner.sh"), "echo started >> starts.txt\nexit 3\n").unwrap();
    let drivers = ["--ego", "idm", "--ego", "slow=cmd:sh planner.sh"];
    let studio = Studio::start(&[&["--procedural", "4"][..], &drivers].concat(), folder.path());
    browser.open(&studio.link());
    // The drive of the other driver is shown.
    browser.wait("document.body.dataset.drawn && !pending");
    assert_eq!(browser.run("return panels.map((p) => p.name)"), json!(["idm"]));
    assert_eq!(browser.run("return document.querySelectorAll('#words .error').length"), 1);
    let starts = || fs::read_to_string(folder.path().join("starts.txt")).unwrap_or_default().len();
    drawn(&browser, || {
        browser.run("element('second').value = ''; element('second').dispatchEvent(new Event('change'))");
    });
    drawn(&browser, || {
        browser.run("openScene(3)");
    });
    drawn(&browser, || {
        browser.run("element('dial').value = 5; element('dial').dispatchEvent(new Event('input'))");
    });
    browser.wait("location.hash.includes('step=5')");
    let address = browser.run("return location.href").as_str().unwrap().to_owned();
    assert!(address.contains("scene=four-way-0-3") && !address.contains("key"), "{address}");
    // Loaded again, or changed by hand.
    let shown = command(&browser);
    browser.run("location.reload()");
    browser.wait("document.body.dataset.drawn && !pending");
    assert_eq!(command(&browser), shown);
    let before = starts();
    assert!(before > 0, "a choice on the page starts it");
    browser.open(&address.replace("ego=idm", "ego=slow"));
    browser.wait("!element('start').hidden");
    assert_eq!(starts(), before, "a link does not");
    browser.run("element('run').click()");
    browser.wait("element('words').innerText.includes('planner')");
    assert!(starts() > before);
}

#[test]
fn by_night_the_page_is_dark() {
    let Some((_studio, browser, _folder)) = opened(1280, 900) else { return };
    let brightness = "(() => { const c = panels[0].canvas.getContext('2d').getImageData(5, 5, 1, 1).data; return (c[0] + c[1] + c[2]) / 3; })()";
    let ground = |browser: &Browser| browser.run(&format!("return {brightness}")).as_f64().unwrap();
    assert!(ground(&browser) > 150.0);
    browser.at_night();
    browser.wait("colour.ground !== day.ground && !waiting");
    assert!(ground(&browser) < 100.0, "{}", ground(&browser));
    let text = browser.run(
        "return [getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]",
    );
    assert_eq!(text, json!(["rgb(22, 24, 26)", "rgb(230, 232, 234)"]));
}

#[test]
fn a_person_tries_an_attack_with_the_keyboard_alone() {
    let Some((_studio, browser, _folder)) = opened(1280, 900) else { return };
    browser.run("element('dial').focus()");
    drawn(&browser, || browser.press(&LEFT.repeat(3)));
    assert!(command(&browser).contains("--lambda 0.85 "), "{}", command(&browser));
    // The keys of the player stay with the slider while it has the keyboard.
    assert_eq!(browser.run("return view.time === now"), true);
    // The list of road users keeps the keyboard.
    drawn(&browser, || {
        browser.run("document.querySelector('#users li:not(.adversary) button:last-child').focus()");
        browser.press(" ");
    });
    assert!(command(&browser).contains("--without "), "{}", command(&browser));
    drawn(&browser, || browser.press(" "));
    assert!(!command(&browser).contains("--without "), "{}", command(&browser));
    browser.run("element('filter').focus()");
    browser.press("four c");
    assert_eq!(browser.run("return element('filter').value"), "four c");
    assert_eq!(browser.run("return element('scenes').children.length"), 0);
    assert_eq!(browser.run("return view.playing"), false);
    let names = browser.run(
        "return [...document.querySelectorAll('aside button, aside select, aside input')].filter((e) => e.tabIndex < 0 || !(e.labels?.length || e.textContent || e.ariaLabel)).map((e) => e.id)",
    );
    assert_eq!(names, json!([]), "what the keyboard or a reader of screens cannot reach");
    browser.press(ESCAPE);
    assert_eq!(browser.messages(), "");
}

#[test]
fn the_page_fits_a_phone() {
    let Some((_studio, browser, _folder)) = opened(390, 800) else { return };
    let width = browser.run("return [document.documentElement.scrollWidth, innerWidth]");
    let [page, window]: [f64; 2] = serde_json::from_value(width).unwrap();
    assert!(page <= window, "{page} wide in {window}");
    let seen = browser.run("return [panels[0].canvas.clientHeight, panels[0].canvas.clientWidth]");
    let [height, wide]: [f64; 2] = serde_json::from_value(seen).unwrap();
    assert!(height > 200.0 && wide > 300.0, "{height} {wide}");
}

#[test]
fn ids_that_hold_markup_are_text_and_a_used_link_says_so() {
    let Some(browser) = Browser::start(1280, 900) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut scene = sage_data::procedural::generate(sage_data::procedural::Kind::FourWay, 1, 0).unwrap();
    let markup = "<img src=x onerror=document.title='broken'>";
    let other = (0..scene.tracks.len()).find(|k| *k != scene.ego && Some(*k) != scene.adversary).unwrap();
    scene.tracks[other].id = markup.into();
    sage_data::Recording::procedural(scene).write(&folder.path().join("scene.safetensors")).unwrap();
    let studio = Studio::start(&["scene.safetensors"], folder.path());
    browser.open(&studio.link());
    browser.wait("document.body.dataset.drawn");
    let text = browser.run("return element('users').innerText");
    assert!(text.as_str().unwrap().contains(markup), "{text}");
    assert_eq!(browser.run("return document.querySelectorAll('img[src=x]').length"), 0);
    assert_ne!(browser.run("return document.title"), "broken");
    // The same tab goes on; another has to use the new link.
    assert_eq!(browser.run("return location.hash.includes('key')"), false);
    browser.run("sessionStorage.clear()");
    browser.open("about:blank");
    browser.open(&studio.link());
    browser.wait("element('words').textContent");
    let said: Value = browser.run("return element('words').innerText");
    assert!(said.as_str().unwrap().contains("this link was used before"), "{said}");
}
