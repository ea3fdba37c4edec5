//! scratch
use sage_backbones::*;
fn main() {
    for f in std::env::args().skip(1) {
        let p = std::path::Path::new(&f);
        let (old, mut header) = Parameters::load(p).unwrap();
        let net = backbones().unwrap().build(&header.backbone, &header.options).unwrap();
        let mut new = Parameters::default();
        for (n, t) in net.parameters().iter() {
            match old.get(n) { Some(o) => { assert_eq!(o.dims(), t.dims(), "{n}"); new.insert(n, o.clone()) } None => { println!("fresh {n}"); new.insert(n, t.clone()) } }
        }
        for (a, b) in [("/tmp/w/procedural", "prior"), ("/tmp/w/waymo-query", "prior"), ("/tmp/w/waymo", "prior"), ("/tmp/w/q96", "prior")] { header.command = header.command.replace(a, b); }
        new.save(&header, p).unwrap(); println!("{f} {}", header.command);
    }
}
