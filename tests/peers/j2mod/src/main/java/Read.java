import com.ghgande.j2mod.modbus.facade.ModbusTCPMaster;
import com.ghgande.j2mod.modbus.procimg.Register;
import com.ghgande.j2mod.modbus.procimg.InputRegister;
import java.util.ArrayList;
import java.util.List;
import java.util.concurrent.Callable;
import java.util.concurrent.ExecutorService;
import java.util.concurrent.Executors;
import java.util.concurrent.Future;

/** 200 reads with j2mod, over four connections at once. */
public final class Read {
    private static final int[][] READS = {{4, 0, 84}, {3, 1000, 70}, {4, 10, 12}, {3, 1002, 4}};
    private static final int ROUNDS = 50;

    private Read() {
    }

    public static void main(String[] arguments) throws Exception {
        int port = Integer.parseInt(arguments[0]);
        ExecutorService threads = Executors.newFixedThreadPool(READS.length);
        List<Future<Void>> readers = new ArrayList<>();
        for (int[] read : READS) {
            readers.add(threads.submit((Callable<Void>) () -> readAgainAndAgain(port, read)));
        }
        threads.shutdown();
        for (Future<Void> reader : readers) {
            reader.get();
        }
    }

    private static Void readAgainAndAgain(int port, int[] read) throws Exception {
        ModbusTCPMaster master = new ModbusTCPMaster("127.0.0.1", port);
        master.connect();
        try {
            for (int round = 0; round < ROUNDS; round++) {
                StringBuilder registers = new StringBuilder();
                InputRegister[] values = read[0] == 4
                    ? master.readInputRegisters(1, read[1], read[2])
                    : (Register[]) master.readMultipleRegisters(1, read[1], read[2]);
                for (InputRegister value : values) {
                    registers.append(registers.length() == 0 ? "" : ", ").append(value.toUnsignedShort());
                }
                String line = String.format(
                    "{\"function\": %d, \"address\": %d, \"registers\": [%s]}", read[0], read[1], registers);
                synchronized (System.out) {
                    System.out.println(line);
                }
            }
        } finally {
            master.disconnect();
        }
        return null;
    }
}
