use sage_backbones::{backbones, nn, parameters::Header, training::*};
use sage_core::scene::SceneIndex;
#[global_allocator]
static A: mimalloc::MiMalloc = mimalloc::MiMalloc;
struct Say(std::time::Instant);
impl Observer for Say {
    fn step(&mut self, e: u32, s: usize, n: usize, l: f64) {
        if s % 25 == 0 {
            eprintln!("  {e} {s}/{n} {l:.3} {:.0}s", self.0.elapsed().as_secs_f64());
        }
    }
    fn epoch(&mut self, r: &EpochRow) {
        println!(
            "{:>3} goal {:.3} path {:.3} grad {:.2} rate {:.1e} minFDE6 {:.2} surprise {:.3} {:.0}s",
            r.epoch, r.goal, r.path, r.gradient, r.rate, r.min_fde6, r.surprise, r.seconds
        );
    }
}
fn load(dir: &str) -> Vec<SceneData> {
    let mut files: Vec<_> = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    files
        .into_iter()
        .map(|f| SceneData::new(f.display().to_string(), sage_data::Recording::read(&f).unwrap().scene))
        .collect()
}
fn main() {
    rayon::ThreadPoolBuilder::new()
        .num_threads(std::env::var("T").map_or(2, |t| t.parse().unwrap()))
        .build_global()
        .unwrap();
    nn::keep_products_on_their_thread();
    let out = std::env::args().nth(1).unwrap();
    let net = std::env::args().nth(2).unwrap_or("{}".into());
    let opt = std::env::args().nth(3).unwrap_or("{}".into());
    let name = std::env::args().nth(4).unwrap_or("densetnt".into());
    let procedural: u64 = std::env::args().nth(5).map_or(0, |x| x.parse().unwrap());
    let network = backbones().unwrap().build(&name, &serde_json::from_str(&net).unwrap()).unwrap();
    println!("{} parameters", network.parameters().numbers());
    let options: PretrainOptions = serde_json::from_str(&opt).unwrap();
    let mut train = load("target/data/womd_cat500/pretrain");
    if procedural > 0 {
        use sage_backbones::training::SceneData;
        use sage_data::procedural::{Kind, generate};
        train = (0..procedural)
            .map(|k| {
                let kind = Kind::ALL[k as usize % 6];
                SceneData::new(format!("{k}"), generate(kind, 77, k).unwrap())
            })
            .collect();
    }
    let dev = load("target/data/womd_cat500/dev");
    let _ = SceneIndex::new(train[0].scene.map.clone());
    std::fs::create_dir_all(&out).unwrap();
    let mut network = network;
    if let Some(from) = std::env::args().nth(6) {
        let (p, _) = sage_backbones::Parameters::load(std::path::Path::new(&from)).unwrap();
        network = network.with_parameters(p, "x").unwrap();
    }
    let header = Header { backbone: name.clone(), options: network.options().clone(), ..Header::default() };
    let r = pretrain(
        &*network,
        &train,
        &dev,
        &options,
        &header,
        std::path::Path::new(&out),
        &mut Say(std::time::Instant::now()),
    )
    .unwrap();
    println!("best {:.2}", r.rows.iter().map(|r| r.min_fde6).fold(1e9, f64::min));
}
