//! nuPlan: SQLite logs, their pickles, GeoPackage maps.

use std::cell::RefCell;
use std::path::Path;

use point_skeleton::dataset::nuplan::NuPlan;
use point_skeleton::dataset::{LogLocator, LogReader};
use rusqlite::types::Value;
use rusqlite::{Connection, params_from_iter};

use super::{LARGE, seed};
use crate::check::{assert_names_file, assert_names_file_in, dataset};
use crate::choices::Choices;
use crate::folder::Folder;
use crate::{Seed, Target};
use pskel_testing::nuplan_log::{LOG, MAP, NuplanLog};

pub(super) const TARGETS: [Target; 5] = [
    Target { name: "nuplan_pages", run: pages, seeds: page_seeds, max_len: 65_536, memory: LARGE },
    Target { name: "nuplan_cells", run: cells, seeds: cell_seeds, max_len: 512, memory: LARGE },
    Target { name: "nuplan_pickle", run: pickle, seeds: pickle_seeds, max_len: 512, memory: LARGE },
    Target {
        name: "nuplan_map_pages",
        run: map_pages,
        seeds: map_page_seeds,
        max_len: 65_536,
        memory: LARGE,
    },
    Target { name: "nuplan_map_cells", run: map_cells, seeds: cell_seeds, max_len: 512, memory: LARGE },
];

/// Data set whose databases have small pages.
struct DataSet {
    folder: Folder,
    database: String,
    map: String,
}

thread_local! {
    static DATA_SET: RefCell<DataSet> = RefCell::new(data_set());
    static PICKLED: RefCell<(DataSet, Connection)> = RefCell::new(pickled());
}

fn data_set() -> DataSet {
    let nuplan = NuplanLog::new();
    for statements in
        ["DELETE FROM lidar_box WHERE rowid > 3", "DELETE FROM image WHERE rowid > 3", SMALL_PAGES]
    {
        nuplan.sql(statements);
    }
    nuplan.map_sql(SMALL_PAGES);
    let folder = Folder::copy_of(&nuplan.path(""));
    let database = format!("nuplan-v1.1/splits/mini/{LOG}.db");
    DataSet { folder, database, map: format!("maps/{MAP}/1.0/map.gpkg") }
}

const SMALL_PAGES: &str = "PRAGMA page_size = 512; VACUUM;";

fn connect(path: &Path) -> Connection {
    let connection = Connection::open(path).expect("a database of ours");
    connection.execute_batch("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;").expect("pragmas");
    connection
}

impl DataSet {
    fn locator(&self) -> LogLocator {
        LogLocator::new(&point_skeleton::dataset::nuplan::FORMAT, self.folder.path(&self.database))
    }

    fn open(&self, data: &[u8]) {
        match NuPlan::open(&self.locator()) {
            Ok(set) => dataset(&set, self.folder.root(), data),
            Err(error) => assert_names_file(error, &self.folder.path(&self.database), data),
        }
    }

    fn open_map(&self, data: &[u8]) {
        let set = NuPlan::open(&self.locator()).expect("a whole log");
        match set.read_map() {
            Ok(map) => crate::check::check_map(&map.expect("a map of ours"), set.recording()),
            Err(error) => assert_names_file_in(error, self.folder.root(), data),
        }
    }
}

fn pages(data: &[u8]) {
    DATA_SET.with_borrow_mut(|set| {
        set.folder.put(&set.database.clone(), data);
        set.open(data);
        set.folder.reset();
    });
}

fn page_seeds() -> Vec<Seed> {
    let set = data_set();
    vec![seed("file", set.folder.base(&set.database)), seed("short", &set.folder.base(&set.database)[..700])]
}

fn map_pages(data: &[u8]) {
    DATA_SET.with_borrow_mut(|set| {
        set.folder.put(&set.map.clone(), data);
        set.open_map(data);
        set.folder.reset();
    });
}

fn map_page_seeds() -> Vec<Seed> {
    let set = data_set();
    vec![seed("file", set.folder.base(&set.map))]
}

fn cells(data: &[u8]) {
    DATA_SET.with_borrow_mut(|set| {
        change(&set.folder.touch(&set.database.clone()), data);
        set.open(data);
        set.folder.reset();
    });
}

fn map_cells(data: &[u8]) {
    DATA_SET.with_borrow_mut(|set| {
        change(&set.folder.touch(&set.map.clone()), data);
        set.open_map(data);
        set.folder.reset();
    });
}

fn cell_seeds() -> Vec<Seed> {
    let all = (0..28_u8).map(|i| seed(&format!("change{i}"), [i, i % 5, i % 3, i % 14, 3, 9, 9, 9]));
    all.chain([seed("none", [])]).collect()
}

/// Changes values, rows and tables of a database; skips invalid statements.
fn change(path: &Path, data: &[u8]) {
    let connection = connect(path);
    let mut choices = Choices::new(data);
    let mut left = 16;
    while !choices.is_empty() && left > 0 {
        let _ = change_once(&connection, &mut choices);
        left -= 1;
    }
}

fn names(connection: &Connection, sql: &str) -> rusqlite::Result<Vec<String>> {
    connection.prepare(sql)?.query_map([], |row| row.get(0))?.collect()
}

fn change_once(connection: &Connection, choices: &mut Choices<'_>) -> rusqlite::Result<()> {
    let tables = names(connection, "SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")?;
    let table = tables[choices.below(tables.len())].as_str();
    let columns = names(connection, &format!("SELECT name FROM pragma_table_info('{table}')"))?;
    let column = columns[choices.below(columns.len())].as_str();
    let row = choices.byte();
    let set = |value: Value| {
        let sql = format!(
            "UPDATE {table} SET {column} = ? WHERE rowid = (SELECT rowid FROM {table} LIMIT 1 OFFSET {row})"
        );
        connection.execute(&sql, params_from_iter([value])).map(|_| ())
    };
    match choices.byte() % 14 {
        0 => set(Value::Null),
        1 => set(choices.integer().into()),
        2 => set(choices.number().into()),
        3 => set(String::from_utf8_lossy(choices.bytes()).into_owned().into()),
        4 => set(choices.bytes().to_vec().into()),
        // Changes a few bytes of an existing value.
        5 | 6 => {
            let sql = format!("SELECT CAST({column} AS BLOB) FROM {table} LIMIT 1 OFFSET {row}");
            let mut bytes: Vec<u8> = connection.query_row(&sql, [], |row| row.get(0))?;
            for _ in 0..=choices.below(4) {
                let at = choices.below(bytes.len());
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = choices.byte();
                }
            }
            set(bytes.into())
        }
        7 => connection.execute_batch(&format!(
            "DELETE FROM {table} WHERE rowid = (SELECT rowid FROM {table} LIMIT 1 OFFSET {row})"
        )),
        8 => connection.execute_batch(&format!("DROP TABLE {table}")),
        // Without keys, so that rows may occur twice.
        9 => connection.execute_batch(&format!(
            "CREATE TABLE other AS SELECT * FROM {table} UNION ALL SELECT * FROM {table}; DROP TABLE {table};
             ALTER TABLE other RENAME TO {table}"
        )),
        10 => connection.execute_batch(&format!(
            "ALTER TABLE {table} RENAME TO other; CREATE VIEW {table} AS \
            SELECT * FROM other"
        )),
        11 => connection.execute_batch(&format!("ALTER TABLE {table} DROP COLUMN {column}")),
        12 => connection.execute_batch(&format!(
            "ALTER TABLE {table} RENAME TO other; CREATE VIEW {table} AS WITH RECURSIVE n(i) AS (SELECT 0 \
                UNION ALL
             SELECT i + 1 FROM n) SELECT other.* FROM other, n"
        )),
        _ => {
            let other = columns[choices.below(columns.len())].as_str();
            connection.execute_batch(&format!("UPDATE {table} SET {column} = {other}"))
        }
    }
}

/// Returns a data set, and an open connection that changes the first camera's matrix.
fn pickled() -> (DataSet, Connection) {
    let set = data_set();
    let connection = connect(&set.folder.path(&set.database));
    (set, connection)
}

fn pickle(data: &[u8]) {
    PICKLED.with_borrow_mut(|(set, connection)| {
        let sql = "UPDATE camera SET intrinsic = ? WHERE channel = 'CAM_F0'";
        connection.execute(sql, [data]).expect("a blob to store");
        set.open(data);
    });
}

fn pickle_seeds() -> Vec<Seed> {
    let set = data_set();
    let connection = connect(&set.folder.path(&set.database));
    let sql = "SELECT intrinsic FROM camera WHERE channel = 'CAM_F0'";
    let bytes: Vec<u8> = connection.query_row(sql, [], |row| row.get(0)).expect("a pickle");
    let class = b"\x80\x02cnuplan.database.common.data_types\nCameraIntrinsic\nq\x00)\x81q\x01(]q\x02(K\x02J\
        \x01\x00\x00\x00M\x01\x00e]ae.";
    let named = b"\x80\x04\x95\x20\x00\x00\x00\x00\x00\x00\x00\x8c\x22nuplan.database.common.data_types\
        \x94\x8c\x08Rotation\x94\x93\x94)\x81\x94G?\xf0\x00\x00\x00\x00\x00\x00a.";
    vec![seed("matrix", bytes), seed("class", *class), seed("named", *named)]
}
